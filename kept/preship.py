import sys; sys.path.insert(0,"tools")
from pathlib import Path
from ship_home import runs
from perdure.policy import load_policy, save_policy
from perdure.home.evaluate.policies import SHIPPED
for name, path in runs(Path(sys.argv[1])).items():
    if not (path/"policy.safetensors").exists(): continue
    target = SHIPPED / f"{name}.safetensors"
    target.parent.mkdir(parents=True, exist_ok=True)
    save_policy(load_policy(path/"policy.safetensors").without_critic().halved(), target)
    print(target)
