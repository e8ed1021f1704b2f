"""The programs of the package: `cp-train`, `cp-calibrate`, `cp-play` and `cp-benchmark`, one module each."""
