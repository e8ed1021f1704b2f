"""Our own detector: encoder f_E, warp f_T, fusion f_F, decoder f_D."""
