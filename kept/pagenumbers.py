"""Numbers of the placement page's sentences, from results/placement/tables (run in the project's root)."""
import polars as pl
T="results/placement/tables/"
s=pl.read_csv(T+"success.csv"); d=pl.read_csv(T+"differences.csv"); sp=pl.read_csv(T+"release-speed.csv"); m=pl.read_csv(T+"modes.csv"); seeds=pl.read_csv(T+"seeds.csv")
pl.Config.set_tbl_rows(200); pl.Config.set_tbl_cols(20); pl.Config.set_tbl_width_chars(200)
for split in ("eval","eval-2"):
    for st in ("rl","rl closed"):
        r=s.filter(split=split,strategy=st)
        if len(r): print(split,st,[(t,round(100*a,1),round(100*u/e,1)) for t,a,u,e in r.select("task","stabilizing mean","unaided","episodes").iter_rows()])
print("closed, all releases:", s.filter(pl.col("split")=="eval", pl.col("strategy").is_in(["rl closed","stop closed","ik closed","guarded closed"])).select("task","strategy","stabilizing mean","stabilizing lower","stabilizing upper","unaided","final","episodes"))
print(d.filter(pl.col("second").str.contains("closed"), split="eval").filter(pl.col("first")+" closed"==pl.col("second")))
print(d.filter(split="eval", first="rl closed"))
print(s.filter(split="eval", task="set_table").filter(pl.col("strategy").str.contains("drag|rolling|0.")).select("strategy","stabilizing mean","stabilizing lower","stabilizing upper"))
print(m.filter(split="eval", strategy="rl").group_by("cause").agg(pl.col("count").sum()).sort("count", descending=True)); print(m.filter(split="eval", strategy="rl closed").group_by("cause").agg(pl.col("count").sum()))
print(seeds.filter(split="eval").filter(pl.col("strategy").is_in(["rl","rl closed"])))
print(sp)
