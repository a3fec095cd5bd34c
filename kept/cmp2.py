"""Finished rows of the grid by training seed."""
import polars as pl
from pathlib import Path
from perdure.home.evaluate.page import read_all
from perdure.home.evaluate.analysis import analyze
logs=sorted(Path("/root/grid-out/runs").rglob("logs.parquet"))
a=analyze(read_all(logs)[0])
seeds=a.seeds.group_by("task","split","strategy",maintain_order=True).agg(pl.col("stabilizing").round(3).cast(pl.Utf8).str.join(" "))
s=a.success.select("task","split","strategy","episodes",(100*pl.col("stabilizing mean")).round(1).alias("stab"),(100*pl.col("unaided")/pl.col("episodes")).round(1).alias("unaided"),"stabilizing lower","stabilizing upper")
with pl.Config(tbl_rows=-1,tbl_cols=-1,tbl_width_chars=200,fmt_str_lengths=60): print(s.join(seeds,on=["task","split","strategy"]))
