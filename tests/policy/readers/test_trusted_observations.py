"""Models that Stable-Baselines3 itself loads: what perdure cannot feed them is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.spaces import Box, Dict

from perdure.errors import PerdureError
from perdure.policy.readers.sb3 import ACTOR_CRITIC
from perdure.policy.readers.trusted import _settings

POLICY = type("ActorCriticPolicy", (), {"__module__": ACTOR_CRITIC, "squash_output": False, "activation_fn": None})


FLATTEN = type("FlattenExtractor", (), {"__module__": "stable_baselines3.common.torch_layers"})


def model(space, extractor=FLATTEN):
    """As much of a loaded PPO as the reader asks for."""
    policy = POLICY()
    policy.activation_fn = type("Tanh", (), {"__module__": "torch.nn.modules.activation"})
    policy.features_extractor = extractor()
    return SimpleNamespace(
        policy=policy,
        observation_space=space,
        action_space=Box(-1.0, 1.0, (2,)),
        use_sde=False,
        gamma=0.99,
        _last_original_obs=None,
        _last_obs=None,
        seed=0,
        num_timesteps=10,
    )


def test_a_vector_is_read():
    assert _settings(model(Box(-1.0, 1.0, (3,))), "x.zip").activation == "tanh"


@pytest.mark.parametrize(
    ("space", "kind"),
    [(Box(0, 255, (96, 96, 3), np.uint8), "image"), (Dict({"a": Box(-1.0, 1.0, (3,))}), "Dict")],
)
def test_images_and_compositions_are_refused(space, kind):
    """Stable-Baselines3 divides images by 255 and transposes them before the policy sees them."""
    with pytest.raises(PerdureError, match=f"x.zip is for {kind} observations; only vectors"):
        _settings(model(space), "x.zip")


def test_a_features_extractor_that_changes_what_the_policy_sees_is_refused():
    other = type("ScaledFlattenExtractor", (FLATTEN,), {"__module__": "mine"})
    with pytest.raises(PerdureError, match=r"x\.zip: its features extractor is ScaledFlattenExtractor, which"):
        _settings(model(Box(-1.0, 1.0, (3,)), other), "x.zip")


def test_an_activation_function_that_only_has_the_name_is_refused():
    loaded = model(Box(-1.0, 1.0, (3,)))
    loaded.policy.activation_fn = type("Tanh", (), {"__module__": "mine"})
    with pytest.raises(PerdureError, match="with Tanh is not read"):
        _settings(loaded, "x.zip")
