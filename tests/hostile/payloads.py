"""Text that a careless page would run, and the files of every kind that hold it in every field of text."""

import importlib.util
import json
import math
from dataclasses import replace
from pathlib import Path

from home_stories import good

from perdure.home.evaluate.files import write_logs
from perdure.report import write_table

RUN = "document.title='owned'"
PAYLOADS = (
    f"<script>{RUN}</script>",
    f"</script><script>{RUN}</script>",
    f"</title><script>{RUN}</script>",
    f"</pre><script>{RUN}</script>",
    f"</td></tr></table><script>{RUN}</script>",
    f"</style><script>{RUN}</script>",
    f"'><img src=x onerror={RUN}>",
    f'"><img src=x onerror="{RUN}">',
    f"<svg onload={RUN}>",
    f"<svg><script>{RUN}</script></svg>",
    f"<body onload={RUN}>",
    f"<iframe srcdoc='<script>parent.{RUN}</script>'>",
    f"<a href='javascript:{RUN}' autofocus onfocus={RUN}>x</a>",
    f"<details open ontoggle={RUN}>",
    f"<input autofocus onfocus={RUN}>",
    f"<meta http-equiv=refresh content='0;url=javascript:{RUN}'>",
    f"<math><mtext></mtext><mglyph><style><!--</style><img title='--><img src=x onerror={RUN}>'>",
    "<!--<script>",
    "<!--",
    "]]>",
    f"&lt;script&gt;{RUN}&lt;/script&gt;",
    f"&#60;script&#62;{RUN}&#60;/script&#62;",
    f"\\u003cscript\\u003e{RUN}\\u003c/script\\u003e",
    f"{{{{constructor.constructor('{RUN}')()}}}}",
    f'datum.constructor.constructor("{RUN}")()',
    f"${{{RUN}}}",
    "<base href='https://example.invalid/'><link rel=stylesheet href=x>",
    "x/../../OUTSIDE",
    "/etc/OUTSIDE",
    "..",
    "<plaintext>",
)


def harmless(text):
    """A word instead of a payload, another one for another payload."""
    return f"word{PAYLOADS.index(text)}"


def _builder():
    path = Path(__file__).parents[1] / "report" / "conftest.py"
    spec = importlib.util.spec_from_file_location("report_conftest", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.build


def table(path, text=lambda payload: payload, payloads=PAYLOADS, tasks=("Hopper-v3",)):
    """A table whose fields of text all hold payloads, a policy for each."""
    groups = [
        {
            **{
                "task": task,
                "policy": text(each),
                "method": text(each),
                "end_detail": text(each),
                "reason": "diverged",
            },
            **{"policy_note": text(each), "ends": [500, math.inf], "rate": 2.0, "clock": "constant(500)"},
        }
        for task in tasks
        for each in payloads
    ]
    frame = _builder()(groups, episodes=2, recorded=(100, 1000))
    clocks = [text(each) for _ in tasks for each in payloads for _ in range(2 * 2)]
    import polars as pl

    frame = frame.with_columns(
        clock=pl.Series(clocks), clock_kind=pl.Series(clocks), policy_state=pl.lit("cannot tell")
    )
    return write_table(path, frame, {"command": " ".join(map(text, payloads))})


def logs(path, text=lambda payload: payload, payloads=PAYLOADS, split=None):
    """A file of logs whose fields of text all hold payloads, a release strategy for each."""
    base = good(0)
    records = [
        replace(
            base,
            **{"place": text(each), "world": text(each), "episode_hash": text(each), "split": split or "val"},
            targets=tuple(replace(target, kind=text(each)) for target in base.targets),
            runs=(replace(base.runs[0], skill=text(each), toward=text(each)), *base.runs),
            final_objects=tuple(replace(final, kind=text(each)) for final in base.final_objects),
        )
        for each in payloads
    ]
    named = {text(each): text(each) for each in payloads}
    notes = {
        **{"policies": json.dumps(named), "command": " ".join(named)},
        **{"hand_overs": json.dumps(dict.fromkeys(named, 1)), "more": " ".join(named)},
    }
    return write_logs(path, records, notes)
