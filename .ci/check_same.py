#!/usr/bin/env python3
"""Check that two files of JSON lines agree except for times (`solve_us`) and last digits of numbers: `.ci/check_same.py ONE OTHER`.

The C libraries of amd64 and arm64 round `hypot` differently, by one unit in the last place.
"""

import json
import math
import sys

AGREES = 1e-9


def difference(one, other):
    """The largest difference of two numbers, relative for numbers above 1; NaN if anything else differs."""
    if isinstance(one, dict) and isinstance(other, dict) and list(one) == list(other):
        pairs = [(one[key], other[key]) for key in one if key != "solve_us"]
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = list(zip(one, other))
    elif type(one) is float and type(other) is float:
        return abs(one - other) / max(1.0, abs(one))
    else:
        return 0.0 if one == other else math.nan
    differences = [difference(*pair) for pair in pairs]
    return math.nan if any(map(math.isnan, differences)) else max(differences, default=0.0)


rows = [[json.loads(line) for line in open(name)] for name in sys.argv[1:3]]
if not rows[0] or len(rows[0]) != len(rows[1]):
    sys.exit(f"{len(rows[0])} rows and {len(rows[1])}")
differences = [difference(*pair) for pair in zip(*rows)]
for row, found in zip(rows[0], differences):
    if not found <= AGREES:
        sys.exit(f"{row['file']}: differs by {found}")
same = differences.count(0.0)
print(f"{len(differences)} frames: {same} the same to the last digit, the largest difference {max(differences):.1e}")
