"""A robot that empties the bin: arms, motion, and the loop from scan to place."""
