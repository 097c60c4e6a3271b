"""When frames and patterns are: the camera's clock, the light's clock, and frames combined to pairs."""
