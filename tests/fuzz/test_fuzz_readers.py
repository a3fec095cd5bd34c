"""Whatever is in a file, a reader refuses it with an error of ours or returns what its consumers can use.

A case is a seed: `random.Random(seed)` chooses a valid file and changes it, in its bytes or in its values with the
checksums made to fit again.
"""

import os
import random
import warnings

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from targets import SHARES

from perdure.runs import OtherSourceWarning

CASES = 10_000
"""In `make test`, over all targets together."""
VERIFY = int(os.environ.get("PERDURE_FUZZ_CASES", "1000000"))
"""In `make verify`."""


def fuzz(target, cases, derandomize):
    @settings(max_examples=cases, deadline=None, database=None, derandomize=derandomize)
    @given(st.integers(0, 2**64 - 1))
    def run(seed):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OtherSourceWarning)
            target(random.Random(seed))

    run()


@pytest.mark.parametrize("target", SHARES, ids=lambda target: target.__name__)
def test_a_reader_refuses_or_its_consumers_can_use_it(target):
    fuzz(target, round(CASES * SHARES[target]), derandomize=True)


@pytest.mark.verify
@pytest.mark.parametrize("target", SHARES, ids=lambda target: target.__name__)
def test_a_reader_refuses_or_its_consumers_can_use_it_in_many_cases(target):
    fuzz(target, round(VERIFY * SHARES[target]), derandomize=False)


def test_the_shares_are_of_everything():
    assert sum(SHARES.values()) == pytest.approx(1.0)
