"""Fit and plot: the bundled arm from its robot file and two recordings; the held-out torque as a page for the browser.

$ .venv/bin/python examples/fit_and_plot.py
monday, train: 2.00 % of the torque is left
tuesday, validation: 1.74 % of the torque is left
offset_elbow 0.527 +- 0.024 N m
Fv_elbow 6.036 +- 0.022 N m s/rad
Ia_elbow 0.631 +- 0.011 kg m^2
Fc_elbow 2.187 +- 0.024 N m
measured and predicted torque: plot-out/elbow.html
"""

from pathlib import Path

import dynident as dy

FILES = Path(dy.__file__).parent / "apps" / "demo" / "files"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll")
COLUMNS = {
    "time": ("time_s", "s"),
    "position": {joint: (f"{joint}.position_rad", "rad") for joint in JOINTS},
    "torque": {joint: (f"{joint}.torque_Nm", "N m") for joint in JOINTS},
}

monday, tuesday = (dy.read_log(FILES / f"{day}.parquet", **COLUMNS) for day in ("monday", "tuesday"))
method = dy.Recipe(time_offset="estimate", base_tilt="estimate")  # least squares; without a recipe: all is chosen
found = dy.identify(FILES / "arm.urdf", {"monday": monday}, {"tuesday": tuesday}, method)
for log in found.validations:
    print(f"{log.name}, {log.role}: {log.errors.relative_error:.2f} % of the torque is left")
for name, value, std, unit in found.frame().select("parameter", "value", "std", "unit").rows():
    if name.endswith("_elbow"):
        print(f"{name} {value:.3f} +- {std:.2g} {unit}")

page = Path("plot-out", "elbow.html")
page.parent.mkdir(exist_ok=True)
found.plot.torque("tuesday", "elbow").write_html(page)
print(f"measured and predicted torque: {page.as_posix()}")
