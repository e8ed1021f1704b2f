"""Action maps: a Box in [-1, 1] becomes a perturbation δ with ‖δ‖ ≤ Δ.

    full     the raw map (C, H, W): gradient attackers act through this same door (PPO on it diverges).
    basis    a few coefficients on fixed directions: black-box.
    guided   eight numbers that steer the detector's own gradient: white-box; what PPO learns on.
    quiet    the same, held back so that the ego's view resembles its last output.

Every map clips actions to [-1, 1]; NaN, infinity and wrong shapes are a ValueError.
"""
