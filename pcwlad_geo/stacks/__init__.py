"""Many images of one ground: the pairs worth measuring, and one adjustment of all of them."""
