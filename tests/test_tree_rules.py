"""The tree keeps the rules of tools/rules.py, and they see what they are about."""

import pytest
import rules


def test_no_rule_is_broken():
    assert rules.broken_rules() == []


@pytest.mark.parametrize(
    ("statement", "found"),
    [
        ("a, b = 1, 2", {"tuple assignments": 1}),
        ("a, b = [], {}", {"tuple assignments": 1}),
        ("a, b = b, a", {"tuple assignments": 1}),
        ("a, b = pair", {}),
        ("a = b, c", {}),
        ("a, b = (c for c in d)", {}),
        ("if x:\n    a = 1 if (b := c) else 2", {"ternaries": 1, "walruses": 1}),
    ],
)
def test_dense_statements_are_counted(statement, found):
    assert +rules.dense_statements(statement) == found
