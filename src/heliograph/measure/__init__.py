"""What arrived of what was sent: counts, error rates with their intervals, and a bench that needs no films."""
