"""Model cards: what a policy is and whether it holds, as the README.md that Hugging Face shows beside a model.

Format: front matter (huggingface.co/docs/hub/model-cards), JSON because that is YAML too, then Markdown for people.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.envs.suites import module_of
from perdure.errors import PerdureError
from perdure.evaluate.judge import read_judged
from perdure.policy import Policy, load_policy
from perdure.policy.files import SHIPPED, SUFFIX, find_policy, is_downloaded
from perdure.report import estimate_table, wording
from perdure.report.estimates import Estimate, headline
from perdure.report.schema import FILE_NOTE, Episodes
from perdure.report.scores import HOLDS_FROM
from perdure.runs import file_digest, write_atomic
from perdure.schema import printable

if TYPE_CHECKING:
    import polars as pl

NAME = "README.md"
HEAD = '---\n{\n "library_name": "perdure",\n'
"""How every card of ours begins."""
LIMITS = """- The verdict is about this simulator, these start states and these clocks. It does not carry over to a real
  robot or to another physics engine.
- Intervals are over evaluation seeds of one trained policy. They say nothing about other training runs of the method.
- Actions are deterministic unless the table names a disturbance."""


def write_card(policy: str | Path, table: str | Path, out: str | Path | None = None) -> Path:
    """Write the model card of a policy and return its path.

    Args:
        policy: As `perdure.policy.find_policy` takes it.
        table: A table of `perdure extrapolate` with episodes of this policy.
        out: The file. By default README.md in the policy's folder, or STEM.README.md if that holds several policies.

    Raises:
        PerdureError: If there is no such policy, the table cannot be read or holds no episode of this policy's file,
            the file to write is there and is no card of ours, or ``out`` is missing for a policy of the package or of
            Hugging Face's cache.
    """
    file = find_policy(policy)
    subject = load_policy(file)
    episodes, notes = read_judged(table)
    path = Path(out) if out is not None else _beside(file)
    if path.exists() and not (
        (old := path.read_text(errors="replace")).startswith(HEAD) and f"# {_title(subject)}\n" in old
    ):
        raise PerdureError(f"{path} exists and is no model card of this policy; name another file with --out")
    files = {name: digest or "" for name, digest in notes.items() if name.startswith(FILE_NOTE)}
    (estimates,) = estimate_table(episodes, _rows_of(file, episodes, files, str(table))).values()
    task = subject.task
    parts = [
        f"---\n{json.dumps(_front_matter(subject, estimates), indent=1)}\n---",
        f"# {_title(subject)}",
        f"A deterministic policy for `{task.name}`: {task.observation_size} observations, {task.action_size} actions, "
        f"a `{subject.activation}` network. {_time(subject)}",
        f"## Does it hold?\n\n{_verdicts(estimates)}",
        f"## Training\n\n{_training(subject)}",
        f"## Limits\n\n{LIMITS}",
        f"## How to use it\n\n{_use(file.name, task.name)}",
    ]
    if command := notes.get("command"):
        parts.append(f"## How the verdict was made\n\n```\n{command}\n```")
    return write_atomic(path, "\n\n".join(parts) + "\n")


def _beside(file: Path) -> Path:
    """Return where the card of a policy file is written by default."""
    if SHIPPED in file.absolute().parents or is_downloaded(file):
        raise PerdureError(
            f"{file} belongs to perdure or to a Hugging Face cache, where no card is written: name a file with --out"
        )
    alone = len(list(file.parent.glob(f"*{SUFFIX}"))) <= 1
    return file.parent / (NAME if alone else f"{file.stem}.{NAME}")


def _rows_of(file: Path, episodes: Sequence[Episodes], files: dict[str, str], table: str) -> pl.Expr:
    """Return which episodes are of a policy file; PerdureError if none is."""
    import polars as pl

    digest = file_digest(file)
    note = pl.format(f"{FILE_NOTE}{{}}, training seed {{}}", "policy", "train_seed")
    mine = note.is_in([name for name, found in files.items() if found == digest])
    if all(part.facts.filter(mine).is_empty() for part in episodes):
        names = [f"{name.removeprefix(FILE_NOTE)} ({found[:12]})" for name, found in sorted(files.items())]
        held = printable(", ".join(names)) or "no policy file"
        raise PerdureError(
            f"{table} holds no episode of {file} (SHA-256 {digest[:12]}): evaluate this file; the table is of {held}"
        )
    return mine


def _title(policy: Policy) -> str:
    return f"{policy.provenance.get('method', 'policy')} on {policy.task.name}"


def _time(policy: Policy) -> str:
    if policy.clock is None:
        return "It has no time-to-go input."
    embedding = policy.protocol.embedding
    return f"It has a time-to-go input ({embedding}); its own clock is `{policy.clock.label}`."


def _front_matter(policy: Policy, estimates: Sequence[Estimate]) -> dict[str, Any]:
    task = policy.task.name
    metrics = [metric for estimate in estimates for metric in _metrics(estimate)]
    result = {
        "task": {"type": "reinforcement-learning", "name": "reinforcement-learning"},
        "dataset": {"name": task, "type": task},
        "metrics": metrics,
    }
    return {
        "library_name": "perdure",
        "pipeline_tag": "reinforcement-learning",
        "tags": ["reinforcement-learning", "deep-reinforcement-learning", "robotics", "long-horizon", "perdure", task],
        "model-index": [{"name": _title(policy), "results": [result]}],
    }


def _metrics(estimate: Estimate) -> list[dict[str, Any]]:
    group = estimate.group
    share = estimate.verdict.share
    where = f"{group.test_horizon:,} steps, clock {group.clock}" + ("" if group.calm else f", {group.disturbance}")
    holds = {"n": group.episodes, "interval": _bounds(share.lower, share.upper), "interval_method": share.method}
    mean = estimate.returns
    returns = {"n": group.episodes, "interval": _bounds(mean.lower[-1], mean.upper[-1]), "interval_method": mean.method}
    return [
        {
            "type": "share_holds",
            "name": f"share of episodes that hold, {where}",
            "value": round(float(share.estimate), 4),
            "args": holds,
        },
        {
            "type": "mean_return",
            "name": f"mean return, {where}",
            "value": round(estimate.final_return, 3),
            "args": returns,
        },
    ]


def _bounds(low: Any, high: Any) -> list[float] | None:
    bounds = [round(float(low), 4), round(float(high), 4)]
    return bounds if bounds[0] == bounds[0] and bounds[1] == bounds[1] else None


def _verdicts(estimates: Sequence[Estimate]) -> str:
    head = ["clock", "disturbance", "steps", "verdict", "hold", "95 % interval", "n", "mean return", "outcomes"]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for estimate in estimates:
        group = estimate.group
        share = estimate.verdict.share
        outcomes = ", ".join(f"{name} {count}" for name, count in Counter(group.verdicts).most_common())
        cells = [
            group.clock,
            group.disturbance,
            f"{group.test_horizon:,}",
            f"**{estimate.verdict.label}**",
            wording.share(float(share.estimate)),
            " to ".join(dict.fromkeys(wording.share(float(bound)) for bound in (share.lower, share.upper))),
            str(group.episodes),
            wording.quantity(estimate.final_return),
            outcomes,
        ]
        lines.append(f"| {' | '.join(cells)} |")
    methods = sorted({estimate.verdict.share.method for estimate in estimates})
    note = (
        f"Interval: {', '.join(methods)}, over evaluation seeds. An episode holds if its reward rate at the end, above "
        "that of an idle robot, is at least "
        f"{100 * HOLDS_FROM:.0f} % of the policy's own within its training horizon."
    )
    verdicts = [estimate.verdict for estimate in estimates]
    evidence = "\n".join(f"- {verdict.sentence}" for verdict in verdicts)
    return "\n\n".join([f"{headline(verdicts)}.", "\n".join(lines), note, evidence])


def _training(policy: Policy) -> str:
    known = policy.provenance
    rows = {
        **{name: known.get(name) for name in ("method", "preset", "seed")},
        "training horizon": f"{policy.protocol.horizon}, its end counts as {policy.protocol.end}",
        "discount factor": f"{policy.protocol.gamma:g}",
        "engine": known.get("engine"),
        "command": f"`{known['command']}`" if known.get("command") else None,
    }
    if policy.reference is not None:
        rows["return within the training horizon"] = (
            f"{policy.reference.returns.mean():,.0f} (mean of {len(policy.reference.lengths)} episodes of at most "
            f"{policy.reference.horizon} steps)"
        )
    return "\n".join(f"- {name}: {value}" for name, value in rows.items() if value is not None)


def _use(file: str, task: str) -> str:
    modules = f" --modules {module}" if (module := module_of(task)) else ""
    return (
        "```python\nimport numpy as np\nimport perdure\n\n"
        f'policy = perdure.load_policy("{file}")  # nothing in the file is executed\n'
        "observations = np.zeros((1, policy.task.observation_size))\n"
        "actions = policy.act(observations, elapsed=np.zeros(1))\n```\n\n"
        f"`perdure extrapolate {file}{modules}` evaluates it again. `perdure inspect {file}` shows all settings."
    )
