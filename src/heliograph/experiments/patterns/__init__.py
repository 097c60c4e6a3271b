"""Single patterns and packets, as sent and as filmed, and the preset's parameters beside the paper's."""
