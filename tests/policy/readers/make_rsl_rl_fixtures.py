"""Write rsl_rl checkpoints and exports, with the actions of rsl_rl's own modules as expected values.

    python tests/policy/readers/make_rsl_rl_fixtures.py FOLDER

Needs rsl-rl-lib and PyTorch, which perdure itself does not: 5.5.1 writes FOLDER/mlp, FOLDER/lstm and FOLDER/gru, each
with model_1.pt, policy.onnx, its weights beside it, policy.pt (TorchScript) and actions.npz. 2.3.3 (without its
dependencies) writes FOLDER/before. Training lasts two iterations on random observations with Pendulum's sizes.
"""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch

SIZE, ACTIONS, STEPS = 3, 1, 40
SPREAD = torch.tensor([1.0, 1.0, 8.0])


class Noise:
    """A vectorized environment of random observations."""

    num_envs, num_actions, max_episode_length, device, cfg = 8, ACTIONS, 20, "cpu", {}

    def __init__(self):
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long)

    def get_observations(self):
        from tensordict import TensorDict

        return TensorDict({"policy": 0.5 + SPREAD * torch.randn(self.num_envs, SIZE)}, [self.num_envs])

    def step(self, actions):
        done = torch.zeros(self.num_envs, dtype=torch.long)
        return self.get_observations(), -actions.abs().sum(1), done, {"time_outs": done}


def now(kind, folder):
    """Train, save and export with rsl_rl 5."""
    from rsl_rl.runners import OnPolicyRunner

    torch.manual_seed(0)
    model = {"class_name": "MLPModel" if kind == "mlp" else "RNNModel", "hidden_dims": [16, 8], "activation": "elu"}
    model |= {"obs_normalization": True}
    model |= {} if kind == "mlp" else {"rnn_type": kind, "rnn_hidden_dim": 12, "rnn_num_layers": 2}
    actor = model | {"distribution_cfg": {"class_name": "GaussianDistribution", "init_std": 1.0}}
    config = {"algorithm": {"class_name": "PPO"}, "actor": actor, "critic": model, "num_steps_per_env": 4}
    config |= {"save_interval": 100, "obs_groups": {"actor": ["policy"], "critic": ["policy"]}, "multi_gpu": None}
    runner = OnPolicyRunner(Noise(), config, log_dir=str(folder), device="cpu")
    runner.learn(2)
    policy = runner.get_inference_policy("cpu")
    with torch.no_grad():
        policy.mlp[-1].weight *= 5.0 if kind == "mlp" else 20.0  # so that actions differ from one another
    runner.save(str(folder / "model_1.pt"), infos={"common_step_counter": 80})
    runner.export_policy_to_onnx(str(folder))
    runner.export_policy_to_jit(str(folder))
    for extra in [*folder.glob("events*"), *folder.glob("git/*"), *folder.glob("model_[02-9].pt")]:
        extra.unlink()
    observations = 0.5 + SPREAD * torch.randn(STEPS, SIZE)
    with torch.no_grad():
        policy.reset()
        actions = torch.cat([policy({"policy": row[None]}) for row in observations])
    np.savez(folder / "actions.npz", observations=observations.numpy(), actions=actions.numpy())


def before(folder):
    """Save as rsl_rl 2 does: `OnPolicyRunner.save` without its logger."""
    from rsl_rl.modules import ActorCritic, EmpiricalNormalization

    torch.manual_seed(1)
    model = ActorCritic(SIZE, SIZE, ACTIONS, actor_hidden_dims=[16, 8], critic_hidden_dims=[8], activation="elu")
    normalizer = EmpiricalNormalization(shape=[SIZE], until=1.0e8)
    observations = 0.5 + SPREAD * torch.randn(STEPS, SIZE)
    normalizer(observations)
    normalizer.eval()
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    model.act_inference(observations).sum().backward()
    optimizer.step()
    saved = {"model_state_dict": model.state_dict(), "optimizer_state_dict": optimizer.state_dict(), "iter": 1}
    saved |= {"infos": None, "obs_norm_state_dict": normalizer.state_dict()}
    torch.save(saved, folder / "model_1.pt")
    with torch.no_grad():
        actions = model.act_inference(normalizer(observations))
    np.savez(folder / "actions.npz", observations=observations.numpy(), actions=actions.numpy())


def main(folder):
    """Write what the installed version writes."""
    torch.set_num_threads(1)
    recent = int(version("rsl-rl-lib").split(".")[0]) >= 5
    for kind in ("mlp", "lstm", "gru") if recent else ("before",):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        if recent:
            now(kind, folder / kind)
        else:
            before(folder / kind)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
