"""Bodies: outlines, gaits, motion, and their coupling to the flow."""
