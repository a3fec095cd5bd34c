"""Whatever is in a file, a reader refuses it with an error of ours or returns what its consumers can use.

A case is a seed: `random.Random(seed)` chooses a valid file and changes it, in its bytes or in its values with the
checksums made to fit again. Tables and logs are not here: they are as trusted as any CSV, and Polars may end the
process over a damaged one.
"""

import os
import random
import warnings

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from targets import TARGETS

from perdure.errors import OtherSourceWarning

CASES = 150
"""Of each reader, in `make test`."""
VERIFY = int(os.environ.get("PERDURE_FUZZ_CASES", "1000000")) // len(TARGETS)
"""Of each reader, in `make verify`."""


def fuzz(target, cases, derandomize):
    @settings(max_examples=cases, deadline=None, database=None, derandomize=derandomize)
    @given(st.integers(0, 2**64 - 1))
    def run(seed):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OtherSourceWarning)
            target(random.Random(seed))

    run()


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.__name__)
def test_a_reader_refuses_or_its_consumers_can_use_it(target):
    fuzz(target, CASES, derandomize=True)


@pytest.mark.verify
@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.__name__)
def test_a_reader_refuses_or_its_consumers_can_use_it_in_many_cases(target):
    fuzz(target, VERIFY, derandomize=False)
