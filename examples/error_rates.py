"""Error rates over distance: a sweep as a notebook of cells."""

# %% [markdown]
# # Error rates over distance
#
# How far can each priority layer be read? A sweep sends random packets through the simulated channel at several
# distances, receives them and counts errors. Run this file as it is, or cell by cell in an editor that knows `# %%`.
# It needs `pip install xarray pandas h5netcdf`.

# %%
import json
import sys

from heliograph import sweep

FEW = "--few" in sys.argv  # a shorter run, to see that all works

# %% [markdown]
# ## The sweep
#
# The preset "static" stands still; only the distance varies. A point ends when each layer has `min_errors` wrong
# codewords or `max_codewords` in all. With `output="folder"` it could be broken off and resumed, and `workers=None`
# takes all cores (in a script, under `if __name__ == "__main__":`).

# %%
data = sweep(
    {"channel.distance_m": [40, 70, 100]},
    preset="static",
    set={"signal.data_pairs": 8 if FEW else 48},
    seed=1,
    min_errors=5 if FEW else 30,
    max_codewords=6 if FEW else 60,
)
print(data)

# %% [markdown]
# ## Rates with their intervals
#
# Every number comes with a 95 % Clopper-Pearson interval, that of the bit error rate at the effective number of bits,
# since bits of a packet fail together. Where no error was met (`fer_is_bound`), its upper end is the result: the rate
# is below about 3 / n.

# %%
for distance in data["channel.distance_m"].values:
    for layer in data.layer.values:
        at = data.sel({"channel.distance_m": distance, "layer": layer})
        shown = f"{float(at.fer):.2f}" if at.codeword_errors else "none"
        print(f"{distance:4} m  {layer:6}  wrong: {shown:5} (below {float(at.fer_high):.2f} of {int(at.codewords)})")

# %% [markdown]
# ## The reach of a layer
#
# Hierarchical coding does its work: the high layer is read where the others are not any more.

# %%
right = data.codewords - data.codeword_errors
reach = {
    layer: [
        int(d) for d in data["channel.distance_m"].values if right.sel({"channel.distance_m": d, "layer": layer}) > 0
    ]
    for layer in map(str, data.layer.values)
}
print(reach)
assert set(reach["low"]) <= set(reach["high"])

# %% [markdown]
# ## Units and provenance
#
# A Dataset knows its units, and what it was made with; `data.to_netcdf("sweep.nc", engine="h5netcdf")` keeps all that.

# %%
print(data["channel.distance_m"].attrs["units"], data["net_bits_per_second"].attrs["units"])
print(f"heliograph {data.attrs['version']}, seed {data.attrs['seed']}")
print("LEDs:", json.loads(data.attrs["settings"])["signal"]["side"] ** 2)
