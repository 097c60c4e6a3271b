"""Published receivers and channel codes by name: each module states the source, the rule, and its open points."""
