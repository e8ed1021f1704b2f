"""What `import cp_env` costs on top of importing gymnasium and pettingzoo: at most 0.1 s, and no torch.

python -m pytest benchmarks/test_import.py -q -s
"""

from __future__ import annotations

import statistics
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
CODE = """
import time
start = time.perf_counter()
import gymnasium, pettingzoo
others = time.perf_counter()
import cp_env
end = time.perf_counter()
import sys
print(others - start, end - others, int("torch" in sys.modules))
"""


def test_import_time() -> None:
    rows = []
    for _ in range(7):
        run = subprocess.run([sys.executable, "-c", CODE], cwd=ROOT, capture_output=True, text=True, check=True)
        rows.append([float(number) for number in run.stdout.split()])
    others, ours, torch = zip(*rows, strict=True)
    print(
        f"\nimport gymnasium, pettingzoo: median {statistics.median(others):.3f} s; "
        f"import cp_env adds median {statistics.median(ours):.3f} s, best {min(ours):.3f} s"
    )
    assert not any(torch)
    assert min(ours) <= 0.1  # the best of several: the others measure the machine's load
