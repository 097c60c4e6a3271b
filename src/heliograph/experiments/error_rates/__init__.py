"""Error rates at rest, on drives, in difficult scenes and with recorded input."""
