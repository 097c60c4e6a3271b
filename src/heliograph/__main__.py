"""The command as ``python -m heliograph``."""

from heliograph.cli.main import run

if __name__ == "__main__":  # a worker process imports this module too
    run()
