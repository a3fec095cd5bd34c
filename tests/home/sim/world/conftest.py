"""Shared by the tests of the world."""

from dataclasses import replace

import numpy as np
import pytest

from perdure.home.tasks.episodes import load_episodes


@pytest.fixture(scope="session")
def empty_room():
    """An apartment without furniture, the middle of its room and half of its sizes in [m]."""
    apartment = replace(load_episodes("set_table", "val").episodes[0].apartment(), pieces=())
    low, high = np.min(apartment.room, axis=0), np.max(apartment.room, axis=0)
    return apartment, 0.5 * (low + high), 0.5 * (high - low)
