"""The page of the home benchmark: tables in, figures and one HTML file that needs no network out.

    comparison.py     the release strategies of one task and split side by side
    success.py        figures: success of the task, per stage (figure 2-2)
    failure_modes.py  figures: outcomes (figures 2-1, 2-3), first unmet stage x failure cause
    placements.py     figures: kinds of objects, cylinders (figure 2-5), state at the release
    tables.py         the same as numbers
    words.py          words for release strategies, worlds, stages, outcomes, objects
    assignment.py     the policies, from the log files
    page.py           write_page

It draws with `perdure.report`, which does not depend on `perdure.home`.
"""

from perdure.home.evaluate.page.assignment import PolicyAssignment, read_assignment
from perdure.home.evaluate.page.page import PAGE, write_page

__all__ = ["PAGE", "PolicyAssignment", "read_assignment", "write_page"]
