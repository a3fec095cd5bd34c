"""A warning of perdure's shows its sentence, and of code only the caller's line."""

import warnings

from perdure.envs import task_spec
from perdure.policy.reference import resolve_training_horizon


def test_a_warning_is_blamed_on_the_line_that_called_perdure():
    from dataclasses import replace

    spec = replace(task_spec("Hopper-v3"), has_step_limit=False)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        resolve_training_horizon(spec, None)
    assert [each.filename for each in caught] == [__file__]
