"""Link: transmitters, channel and receiver composed, and films with truth."""
