"""Published receivers by name: each module states the source, the rule, and what the source leaves open."""
