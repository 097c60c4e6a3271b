"""Published receivers and channel codes by name: each module states the source, the rule, and open points of the source."""
