"""Mistakes in the geometry: overlap, suppression, poses in the plane and in space."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

FILE = "cp_env/geometry/boxes.py"
TESTS = ("tests/cp_env/geometry/test_boxes.py",)
PLANAR = ("tests/cp_env/geometry/test_planar.py",)
SPATIAL = ("tests/cp_env/geometry/test_spatial.py",)
TESTS_EDGES = ("tests/cp_env/geometry/test_boxes_edges.py",)

MUTANTS = (
    Mutant("union-with-the-overlap-twice", FILE, "area_a + area_b - shared", "area_a + area_b", TESTS),
    Mutant("an-overlap-that-equals-the-threshold", FILE, "iou > above", "iou >= above", TESTS_EDGES),
    Mutant(
        "suppressed-at-the-threshold",
        FILE,
        "_iou(ranked[i], ranked[j]) > iou",
        "_iou(ranked[i], ranked[j]) >= iou",
        TESTS,
    ),
    Mutant("worst-score-first", FILE, "np.lexsort((-scores, views))", "np.lexsort((scores, views))", TESTS),
    Mutant("suppressed-boxes-suppress", FILE, "if stays[better]:", "if better != worse:", TESTS),
    Mutant(
        "a-circle-without-the-corners",
        FILE,
        "0.5 * np.hypot(boxes[:, 2], boxes[:, 3])",
        "0.5 * np.maximum(boxes[:, 2], boxes[:, 3])",
        TESTS,
    ),
    Mutant("turned-the-other-way", FILE, "turn = b[4] - a[4]", "turn = a[4] - b[4]", TESTS),
    Mutant("reflected-centres", FILE, "cos * north - sin * east", "cos * north + sin * east", TESTS),
    Mutant("boxes-without-area-are-refused", FILE, "array[..., 2:4].min() < 0:", "array[..., 2:4].min() <= 0:", TESTS),
    Mutant("rows-of-the-other-set", FILE, "flat_b[start_b[view] + j]", "flat_b[start_a[view] + j]", TESTS),
    Mutant(
        "composed-with-a-turn-back",
        "cp_env/geometry/planar.py",
        "a_T_b[..., 0] + cos * x - sin * y, a_T_b[..., 1] + sin * x + cos * y",
        "a_T_b[..., 0] + cos * x + sin * y, a_T_b[..., 1] - sin * x + cos * y",
        PLANAR,
    ),
    Mutant(
        "an-inverse-that-is-not-turned", "cp_env/geometry/planar.py", "-cos * x - sin * y", "-cos * x + sin * y", PLANAR
    ),
    Mutant("the-lattice-point-below", "cp_env/geometry/planar.py", "np.round(", "np.floor(", PLANAR),
    Mutant(
        "an-inverse-with-the-translation-forward",
        "cp_env/geometry/spatial.py",
        "-back @ a_T_b[..., 3:]",
        "back @ a_T_b[..., 3:]",
        SPATIAL,
    ),
    Mutant(
        "a-quaternion-of-the-other-hand",
        "cp_env/geometry/spatial.py",
        "2 * (x * y - w * z), 2 * (x * z + w * y)",
        "2 * (x * y + w * z), 2 * (x * z + w * y)",
        SPATIAL,
    ),
)
