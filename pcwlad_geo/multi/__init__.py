"""Many images: batches of pairs, the bands of a sensor against each other, stacks adjusted together."""
