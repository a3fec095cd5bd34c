"""Control steps a second of mjlab's velocity environment of Unitree Go1, with one robot on a processor.

Needs `pip install mjlab==1.6.0`. Beside it: `python benchmarks/measure.py robot CONTRACT` for the same robot.
"""

import time

import mjlab.tasks  # noqa: F401 (registers them)
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.tasks.registry import load_env_cfg

STEPS = 100

torch.set_num_threads(1)
config = load_env_cfg("Mjlab-Velocity-Flat-Unitree-Go1")
config.scene.num_envs = 1
env = ManagerBasedRlEnv(cfg=config, device="cpu")
env.reset()
actions = torch.zeros(1, env.action_space.shape[-1])
for k in range(5 + STEPS):
    if k == 5:  # the first ones compile
        began = time.process_time()
    env.step(actions)
print(f"{STEPS / (time.process_time() - began):.1f} control steps of {env.step_dt:g} s a second of processor time")
