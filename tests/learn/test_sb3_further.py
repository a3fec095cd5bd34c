"""The Python of docs/how-to/when-a-policy-fails.md trains a model of Stable-Baselines3 further."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "when-a-policy-fails.md"
BLOCKS = re.findall(
    r"^<!-- test: elsewhere; tests/learn/test_sb3_further.py -->\n```python\n(.*?)^```",
    PAGE.read_text(),
    re.MULTILINE | re.DOTALL,
)
STEPS = 256


@pytest.mark.verify
@pytest.mark.parametrize("anew", [False, True], ids=["as loaded", "critic anew"])
def test_it_trains_further_with_a_longer_horizon_under_noise(anew, tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    monkeypatch.chdir(tmp_path)
    env = VecNormalize(make_vec_env("Hopper-v5", seed=0))
    model = PPO("MlpPolicy", env, n_steps=STEPS, learning_rate=1e-3, seed=0, device="cpu").learn(STEPS)
    model.save("model.zip")
    env.save("vecnormalize.pkl")
    critic = model.policy.value_net.weight.detach().numpy().copy()
    seen = {}

    def learn(self, steps):
        """Look at the model that is about to be trained, and train it shortly."""
        assert steps == 300_000
        seen["critic"] = self.policy.value_net.weight.detach().numpy().copy()
        seen["optimizer"] = len(self.policy.optimizer.state)
        seen["std"] = self.policy.log_std.detach().numpy().copy()
        return original(self, STEPS)

    original = PPO.learn
    monkeypatch.setattr(PPO, "learn", learn)
    further, reset = BLOCKS
    if anew:
        further = further.replace("model.learn", f"{reset}model.learn")
    names = {}
    exec(compile(further, PAGE.name, "exec"), names)
    trained = names["model"]
    assert (trained.gamma, trained.rollout_buffer.gamma) == (0.999, 0.999)
    assert "Disturb" in str(trained.env.venv.envs[0])
    assert (seen["std"] == -1).all()
    assert np.array_equal(seen["critic"], critic) != anew
    assert (seen["optimizer"] == 0) == anew
    assert names["env"].obs_rms.count > env.obs_rms.count
    assert not np.array_equal(
        trained.policy.action_net.weight.detach().numpy(), model.policy.action_net.weight.detach().numpy()
    )
    assert {path.name for path in tmp_path.iterdir()} >= {"further.zip", "further.pkl"}
