"""The paper's figures and tables, one module each: `run(context)` gives a chapter of the report."""
