"""Other systems in the same channel: on-off keying, repetition and the hierarchical code."""
