"""Bodies: outlines, gaits, motions and states, without the flow around them."""
