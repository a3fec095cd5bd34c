"""What tests of several files use."""

from functools import partial

import pytest

from perdure.evaluate.reference import measure_idle


@pytest.fixture(scope="module")
def short_idle():
    """Idle robots are measured over a tenth of the usual steps, in this process alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("perdure.evaluate.reference.measure_idle", partial(measure_idle, steps=100))
        yield
