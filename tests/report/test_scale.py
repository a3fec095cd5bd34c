"""Memory of a large report, measured from outside by the benchmark."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

SCALE = Path(__file__).parents[2] / "benchmarks" / "scale.py"


@pytest.mark.verify
def test_the_report_of_a_million_and_a_half_rows_takes_less_than_half_a_gigabyte():
    command = [sys.executable, str(SCALE), "report", "105", "10500"]
    rows = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    small, large = (float(re.findall(r"[\d.,]+", row)[-1].replace(",", "")) for row in rows[-2:])
    assert 50 < small < large < 500  # MB
