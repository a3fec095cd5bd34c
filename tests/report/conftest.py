"""Synthetic extrapolation tables whose truth is known."""

import math

import numpy as np
import polars as pl
import pytest

RECORDED_STEPS = (100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000)


def episode_rows(episode, ends, rate, last_rate=None, recorded=RECORDED_STEPS):
    """Rows of one episode: `rate` reward per step until `ends` (inf: never); the last tenth at `last_rate` if it lives.

    Its return after s steps is rate * min(s, ends) exactly (last_rate None), and it is alive at s when ends > s. Ending
    before its first whole window of 1,000 steps, it has no score.
    """
    horizon = recorded[-1]
    survives = ends > horizon
    end_step = horizon if survives else int(ends)
    reason = "survived" if survives else episode.pop("reason", "terminated")
    episode.pop("reason", None)
    late = rate if last_rate is None else last_rate
    base = {"test_horizon": horizon, "end_reason": reason, "end_step": end_step} | episode
    base |= {name: base.get(name, value) for name, value in judged(rate, late, survives, reason, end_step).items()}
    return [
        base
        | {
            "step": step,
            "return": rate * min(step, end_step) + (late - rate) * max(0, min(step, end_step) - horizon * 9 // 10),
            "alive": survives or step < end_step,
        }
        for step in recorded
    ]


def judged(rate, late, survives, reason, end_step):
    """What the evaluation says of an episode whose policy earns `rate` in training, an idle robot nothing."""
    score = late / rate if rate else math.nan
    running = "holds" if score >= 0.75 else "decays" if score >= 0.25 else "fails silently"
    ended = {"terminated": "falls", "diverged": "diverges", "truncated": "cut"}
    outcome = running if survives else ended[reason]
    return {
        "end_detail": "",
        "movement_first": 0.3,
        "movement_last": 0.3 if survives else math.nan,
        **dict.fromkeys(("goal_first_step", "goal_longest_stay", "goal_at_end"), math.nan),
        "idle_rate": 0.0,
        "training_rate": rate,
        "published_rate": 4.0,
        "window": 1000,
        "settling": 0,
        "training_falls": 0.0,
        "policy_state": "worked",
        "policy_note": "within its training horizon it earns more",
        "outcome": outcome,
        "failed_step": end_step * 9 // 10 if outcome in ("decays", "fails silently") else end_step,
        "end_score_vs_training": score if survives else 1.0 if end_step >= 1000 else math.nan,
        "ever_idle": outcome == "fails silently",
        "other_engine": "",
        "idle_steps": math.nan,
        **dict.fromkeys(("way_rate", "training_low_share", "low_share"), math.nan),
        **dict.fromkeys(("calm_rate", "work_vs_calm", "work_vs_published"), math.nan),
    }


def clock_columns(clock):
    """Split "constant(500)" into the three clock columns."""
    kind, _, steps = clock.rstrip(")").partition("(")
    return {"clock": clock, "clock_kind": kind, "clock_steps": float(steps) if steps else math.nan}


def build(groups, episodes=8, train_seeds=(0,), recorded=RECORDED_STEPS, seed=0):
    """Build a table.

    Each group is a dictionary: task, method, clock, train_horizon, rate (reward per step), and one of
    hazard (probability to end per step: P(alive at s) = (1 - hazard)^s) or ends (one end step per episode). `spread` is
    the standard deviation of the rate over episodes; `last_rate` replaces the rate in the last tenth.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for group in groups:
        group = dict(group)
        hazard, ends = group.pop("hazard", 0.0), group.pop("ends", None)
        rate, last_rate, spread = group.pop("rate", 1.0), group.pop("last_rate", None), group.pop("spread", 0.0)
        base = {"task": "Hopper-v3", "method": "geometric", "train_horizon": 1000.0}
        base |= {"step_seconds": 0.008, "not_applied": ""}
        base |= clock_columns(group.pop("clock", "constant(500)")) | group
        for train_seed in train_seeds:
            policy = group.get("policy", base["method"])
            for episode in range(episodes):
                end = ends[episode] if ends is not None else rng.geometric(hazard) if hazard else math.inf
                labels = base | {
                    "policy": policy,
                    "train_seed": train_seed,
                    "eval_seed": episode,
                    "disturbance": group.get("disturbance", "none"),
                }
                own_rate = rng.normal(rate, spread) if spread else rate
                rows += episode_rows(labels, end, own_rate, last_rate, recorded)
    return typed(pl.DataFrame(rows))


def typed(frame):
    from perdure.report import COLUMNS

    return frame.select(pl.col(name).cast(kind) for name, kind in COLUMNS.items())


@pytest.fixture(scope="session")
def synthetic():
    """The builder of synthetic tables."""
    return build
