"""Running the benchmark's protocol: which policies, which episodes, kept so that a killed run resumes.

Contents:
    Protocol, run_protocol, parts     episodes x training seeds x evaluation seeds
    placing                           what `--place` asks for
    arm_name, read_arm                how logs call an arm, and back
    choose_policies, make_actors      who acts in which skill
    logged_policies                   who acted in the skills of logs
"""

from perdure.home.evaluate.protocol.job import LOGS, parts
from perdure.home.evaluate.protocol.naming import arm_name, read_arm
from perdure.home.evaluate.protocol.placing import Placing, placing
from perdure.home.evaluate.protocol.policies import choose_policies, logged_policies, make_actors, shipped_policy
from perdure.home.evaluate.protocol.protocol import Protocol
from perdure.home.evaluate.protocol.run import run_protocol

__all__ = [
    "LOGS",
    "Placing",
    "Protocol",
    "arm_name",
    "choose_policies",
    "logged_policies",
    "make_actors",
    "parts",
    "placing",
    "read_arm",
    "run_protocol",
    "shipped_policy",
]
