"""Compare seed 0 of finished rows with the committed table of one training."""
import polars as pl
from pathlib import Path
from perdure.home.evaluate.page import read_all
from perdure.home.evaluate.analysis import analyze
logs=sorted(Path("/root/grid-out/runs").rglob("logs.parquet"))
records,notes=read_all(logs)
a=analyze(records)
print(a.success.select("task","split","strategy","train_seeds","eval_seeds","episodes","stabilizing mean","final","unaided"))
print(a.seeds)
