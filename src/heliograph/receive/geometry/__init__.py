"""The array in the image: its pose, the light of its LEDs on pixels, and the fit of both to the camera frames."""
