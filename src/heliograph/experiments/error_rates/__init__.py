"""What the figure of error rates needs: films counted packet by packet, compared, judged and shown."""
