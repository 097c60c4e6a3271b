"""When frames and patterns are: the clocks of camera and light, and frames combined to pairs."""
