"""The array followed from pair to pair: Kalman filter, fits of sums and headers, decisions, refined poses."""
