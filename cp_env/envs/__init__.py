"""The environments: PettingZoo parallel, Gymnasium single and vectorised, all over one `World`."""
