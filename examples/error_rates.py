"""Error rates over distance: a sweep as a notebook."""

# %% [markdown]
# # Error rates over distance
#
# A sweep sends random packets through the simulated channel at several distances, decodes the packets and counts errors
# per priority layer. Run this file as a script, or cell by cell in an editor with `# %%` support. The notebook requires
# `pip install '.[analysis]'` in a clone.

# %%
import json
import sys

from heliograph import sweep

FEW = "--few" in sys.argv  # a shorter run for tests

# %% [markdown]
# ## The sweep
#
# In the preset "static" the scene is at rest; the sweep varies the distance. A point ends when each layer has
# `min_errors` codeword errors or `max_codewords` codewords. `output="folder"` allows interrupting and resuming.
# `workers=None` uses all cores (in a script, under `if __name__ == "__main__":`).

# %%
data = sweep(
    {"channel.distance_m": [40, 70, 100]},
    preset="static",
    set={"signal.data_pairs": 8 if FEW else 48},
    seed=1,
    min_errors=5 if FEW else 30,
    max_codewords=2 if FEW else 60,
)
print(data)

# %% [markdown]
# ## Rates with their intervals
#
# Every rate has a 95 % Clopper-Pearson interval. Bit errors within a packet are correlated, so the bit error rate uses
# an effective number of bits. If no error occurred (`fer_is_bound`), the upper limit is the result, about 3 / n.

# %%
for distance in data["channel.distance_m"].values:
    for layer in data.layer.values:
        at = data.sel({"channel.distance_m": distance, "layer": layer})
        shown = f"{float(at.fer):.2f}" if at.codeword_errors else "none"
        print(f"{distance:4} m  {layer:6}  wrong: {shown:5} (below {float(at.fer_high):.2f} of {int(at.codewords)})")

# %% [markdown]
# ## The reach of a layer
#
# With hierarchical coding, the high layer remains decodable beyond the range of the other layers.

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
# A Dataset stores units, settings, version and seed; `data.to_netcdf("sweep.nc", engine="h5netcdf")` preserves these
# attributes.

# %%
print(data["channel.distance_m"].attrs["units"], data["net_bits_per_second"].attrs["units"])
print(f"heliograph {data.attrs['version']}, seed {data.attrs['seed']}")
print("LEDs:", json.loads(data.attrs["settings"])["signal"]["side"] ** 2)
