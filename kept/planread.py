import sys
from collections import Counter, defaultdict
from pathlib import Path
from perdure.home.evaluate.files import read_logs
from perdure.home.evaluate.outcomes import stages_stabilizing
import perdure.home.evaluate.log as L
out=defaultdict(lambda: [0,0,0]); sk=defaultdict(Counter)
for p in sorted(Path(sys.argv[1]).rglob("logs.parquet")):
    r=read_logs(p); logs=r[0] if isinstance(r,tuple) else r
    for l in logs:
        k=(l.task,l.train_seed); out[k][1]+=1; out[k][0]+=all(stages_stabilizing(l))
        out[k][2]+=any(s.scripted and s.skill!="reset_arm" for s in l.runs)
        for s in l.runs:
            if not s.scripted: sk[k][(s.skill,bool(s.success))]+=1
for k,v in sorted(out.items()):
    print(k,v, {n:f"{sk[k][(n,True)]}/{sk[k][(n,True)]+sk[k][(n,False)]}" for n in sorted({a for a,_ in sk[k]})})
