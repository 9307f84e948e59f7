"""Tables of frames as a solver's results have them, for tests."""

import pandas as pd


def table(**columns):
    n = len(next(iter(columns.values())))
    base = {"frame_id": [f"frame-{i}" for i in range(n)], "status": ["fix"] * n, "error_km": [1.0] * n}
    return pd.DataFrame({**base, **columns})
