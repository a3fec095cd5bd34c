"""Running the benchmark's protocol: which policies, which episodes, stored so that a killed run resumes.

Contents:
    EvaluationProtocol, run_protocol, episode_blocks   episodes x training seeds x evaluation seeds
    read_release, ReleaseChoice              what `--place` means
    strategy_name, read_strategy             the name of strategy and world in logs, and back
    choose_policies, make_agents             which policy acts in which skill
    logged_policies                          the policies that logs name
"""

from perdure.home.evaluate.protocol.naming import read_strategy, strategy_name
from perdure.home.evaluate.protocol.policies import choose_policies, logged_policies, make_agents
from perdure.home.evaluate.protocol.protocol import EvaluationProtocol
from perdure.home.evaluate.protocol.release_choice import ReleaseChoice, read_release
from perdure.home.evaluate.protocol.run import run_protocol
from perdure.home.evaluate.protocol.units import LOGS, episode_blocks

__all__ = [
    "LOGS",
    "EvaluationProtocol",
    "ReleaseChoice",
    "choose_policies",
    "episode_blocks",
    "logged_policies",
    "make_agents",
    "read_release",
    "read_strategy",
    "run_protocol",
    "strategy_name",
]
