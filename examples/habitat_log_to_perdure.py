"""Logs of another simulator of the Home Assistant Benchmark, such as Habitat, as perdure reads them, and what they say.

    python examples/habitat_log_to_perdure.py log.json --strategy TP+SRL --train-seed 100 --out logs.parquet

The JSON is what a few lines in an evaluation loop can write, in the simulator's own axes (y up):

    {"control_hz": 30, "episodes": [{
        "task": "set_table", "split": "val", "episode_id": 12, "eval_seed": 0, "steps": 2710, "diverged": false,
        "targets": [{"kind": "024_bowl", "cylinder": false, "container": "drawer", "goal": [x, y, z]}, ...],
        "skills": [{"name": "navigate", "target": 0, "begin": 0, "end": 93, "ending": "stopped"}, ...],
        "history": [{"objects": [[x, y, z], ...],  middles of the targets
                     "up": [1.0, ...],             y of their own up axes in the room
                     "held": -1,                   target in the gripper, -1 nothing, -2 clutter or a handle
                     "gripper": [x, y, z], "base": [x, y, z, heading], "force": 0.0,
                     "containers": {"drawer": 0.0, "fridge": 0.0}}, ...]}]}

Skills have the names of `SKILL_VERBS` in `perdure.home.tasks.tasks`. `ending` is "stopped", "timed out" or
"task limit"; "forced": true where the gripper was opened by force. The history has one entry per control step and goes
on after `steps` for a settling time in which the robot stands still: 5 s, or "it stays" cannot be said.
"""

import argparse
import hashlib
import json

import numpy as np

from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.files import read_logs, write_logs
from perdure.home.evaluate.log import EpisodeLog, History, SkillRun, Target
from perdure.home.evaluate.page import summary_text
from perdure.home.tasks.tasks import WorldFacts


def z_up(points) -> np.ndarray:
    """(x, y, z) with y up to (x, -z, y): a turn about x. Headings about the upward axis stay what they are."""
    x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    return np.stack([x, -z, y], axis=-1)


def history_of(episode: dict, control_hz: float) -> History:
    rows = episode["history"]
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0] if name != "containers"}
    containers = {name: np.array([row["containers"][name] for row in rows]) for name in rows[0]["containers"]}
    objects, base = z_up(columns["objects"]), columns["base"]
    goals = z_up([target["goal"] for target in episode["targets"]])
    moved = np.linalg.norm(np.diff(objects, axis=0, prepend=objects[:1]), axis=-1)
    return History(
        facts=WorldFacts(objects, goals, columns["held"], containers),
        up=columns["up"],
        speed=moved * control_hz,
        gripper=z_up(columns["gripper"]),
        base=np.column_stack([z_up(base[:, :3])[:, :2], base[:, 3]]),
        force=columns["force"],
        control_hz=control_hz,
    )


def log_of(episode: dict, control_hz: float, strategy: str, train_seed: int) -> EpisodeLog:
    history = history_of(episode, control_hz)
    start = json.dumps([episode["targets"], episode["history"][0]["objects"]])
    runs = [
        SkillRun(
            *(skill["name"], skill["target"], 1, "", False, skill["begin"], skill["end"], skill["ending"]),
            success=False,
            forced_release=skill.get("forced", False),
        )
        for skill in episode["skills"]
    ]
    return EpisodeLog(
        **{name: episode[name] for name in ("task", "split", "eval_seed", "steps", "diverged")},
        index=episode["episode_id"],
        episode_hash=hashlib.sha256(start.encode()).hexdigest(),
        place=strategy,
        train_seed=train_seed,
        control_hz=control_hz,
        length=len(episode["history"]),
        targets=tuple(
            Target(t["kind"], t["cylinder"], t["container"], tuple(z_up(t["goal"]).tolist()))
            for t in episode["targets"]
        ),
        runs=tuple(map(history.measured, runs)),
        events=history.events,
        releases=history.releases,
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log")
    parser.add_argument("--strategy", required=True)
    parser.add_argument("--train-seed", type=int, default=-1)
    parser.add_argument("--out", required=True)
    args = parser.parse_args(arguments)
    with open(args.log, encoding="utf-8") as stream:
        log = json.load(stream)
    logs = [log_of(each, float(log["control_hz"]), args.strategy, args.train_seed) for each in log["episodes"]]
    write_logs(args.out, logs, {"made from": args.log})
    print(summary_text(analyze(read_logs(args.out))))


if __name__ == "__main__":
    main()
