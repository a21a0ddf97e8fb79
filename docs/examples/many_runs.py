import granfabric as gf

swept = gf.sweep(
    "p_constant",
    {"material.coordination": [3.6, 3.8, 4.0], "closure.force_change": ["mean_field", "shifted_distribution"]},
    results=["coordination:at:q/p=0.2", "coordination", "fabric_anisotropy"],
    output="many",
    workers=2,
)
print(swept.outcome, len(swept.table))
print(swept.table[["coordination:at:q/p=0.2", "coordination", "fabric_anisotropy"]].round(4).to_string())
lost = swept.table["material.coordination"] - swept.table["coordination"]
print("lost by q/p = 0.3:", lost.groupby(swept.table["closure.force_change"]).mean().round(3).to_dict())
print(swept.read("coordination=3.6_force_change=mean_field").history["q"].iloc[-1])
