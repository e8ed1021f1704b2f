"""What readers of recorded drives share: leaning boxes, the road's height, sweeps in place, carriers, tracks."""
