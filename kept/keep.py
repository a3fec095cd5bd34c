import shutil, sys
from pathlib import Path
from perdure.policy import load_policy, save_policy
runs=Path("/root/base33-runs"); kept=Path("/root/wt/b6/kept")
for path in sorted((runs/"perdure").glob("*/*/seed-*/policy.safetensors")):
    rel=path.relative_to(runs); target=kept/"home-runs"/rel
    if target.exists(): continue
    target.parent.mkdir(parents=True, exist_ok=True)
    save_policy(load_policy(path).halved(), target)
    shutil.copy(path.parent/"unit.json", target.parent)
    print("kept", rel)
for mark in (runs/"done").iterdir():
    (kept/"done"/mark.name).touch()
for old in (kept/"working",):
    shutil.rmtree(old, ignore_errors=True)
for work in (runs/".working").iterdir():
    if (work/"checkpoint.safetensors").exists():
        shutil.copytree(work, kept/"working"/work.name); print("checkpoint", work.name)
