"""Valid values of the columns of an extrapolation table, and consistency rules between them."""

from __future__ import annotations

from perdure.schema import Choice, Flag, Maybe, Real, Rule, Table, Text, Whole

END_REASONS = ("survived", "terminated", "truncated", "diverged")
POLICY_STATES = ("worked", "never worked", "cannot tell")
OUTCOMES = ("holds", "decays", "fails silently", "falls", "diverges", "cut", "unknown")
MOST_STEPS = 10**15
NAME = Text(shortest=1)
"""Of a policy, a task, a method or a clock."""
_STEPS = Whole(1, MOST_STEPS)
_RATE = Real(unknown=True)

ROW = Table(
    {
        "policy": NAME,
        "method": NAME,
        "task": NAME,
        "train_seed": Whole(),
        "train_horizon": Real(1.0, infinite=True, unknown=True),
        "clock": NAME,
        "clock_kind": NAME,
        "clock_steps": Real(0.0, infinite=True, unknown=True),
        "eval_seed": Whole(),
        "test_horizon": _STEPS,
        "step": _STEPS,
        "return": Real(),
        "alive": Flag(),
        "end_reason": Choice(END_REASONS),
        "end_step": _STEPS,
        "end_detail": Text(2000),
        "movement_first": Real(0.0, unknown=True),
        "movement_last": Real(0.0, unknown=True),
        "idle_rate": _RATE,
        "reference_rate": _RATE,
        "level_rate": _RATE,
        "window": Whole(0, MOST_STEPS),
        "policy_state": Choice(POLICY_STATES),
        "policy_note": Text(2000),
        "outcome": Choice(OUTCOMES),
        "failed_step": Whole(0, MOST_STEPS),
        "end_hold": Real(unknown=True),
        "ever_idle": Flag(),
    },
    rules=(
        Rule(
            f"train_horizon must be at most {MOST_STEPS:.0e} steps, or infinite",
            lambda of: of("train_horizon").is_finite() & (of("train_horizon") > MOST_STEPS),
        ),
        Rule("the recorded step lies beyond the test horizon", lambda of: of("step") > of("test_horizon")),
        Rule("end_step lies beyond the test horizon", lambda of: of("end_step") > of("test_horizon")),
        Rule("failed_step lies beyond the test horizon", lambda of: of("failed_step") > of("test_horizon")),
        Rule("the lane is alive after its end_step", lambda of: of("alive") & (of("step") > of("end_step"))),
        Rule("the lane has ended before its end_step", lambda of: ~of("alive") & (of("step") < of("end_step"))),
    ),
)
"""One row of version 2."""
NOTES = Table({}, others=Maybe(Text(100_000, lines=True)))
"""The file's metadata."""
