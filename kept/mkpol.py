"""Links with plain names to the trained policies: pol/TASK/POLICY/seed-K."""
import re
from pathlib import Path
runs=[Path("/root/wt/b6/kept/home-runs/perdure"), Path("/root/base33-runs/perdure")]
out=Path("/root/pol")
for base in runs:
    for p in sorted(base.glob("*/*/seed-*/policy.safetensors")):
        name=p.parent.parent.parent.name; task=re.search(r"task=(\w+)",name)[1]; pol=p.parent.parent.name
        for v in ("gentle","hand"):
            if f",{v}=True" in name: pol+="-"+v
        if "CloseFridge" in name and base==runs[1]: continue
        t=out/task/pol/(p.parent.name+".safetensors")
        t.parent.mkdir(parents=True,exist_ok=True)
        if not t.is_symlink(): t.symlink_to(p); print(t, "->", p)
