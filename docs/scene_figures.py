"""Pictures of the catalogue: runs every shipped scene and shrinks what it draws.

    python docs/scene_figures.py [RESULTS] [NAME ...]

Finished runs in RESULTS (results/scenes if not given) are used again. With names, these scenes alone.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from PIL import Image

from granfabric.cases.scene.catalogue import shipped

FIGURES = Path(__file__).resolve().parent / "figures"
WIDTH = 900
COMMANDS = {"point": ["point"], "field": ["run", "--set", "output.every=1000"], "dem": ["dem"], "specimen": ["dem"]}
SHOWN = {"point": "microvariables.png", "field": "overview.png", "dem": "overview.png", "specimen": "overview.png"}


def shrink(source: Path, target: Path, width: int = WIDTH) -> None:
    """Smaller copy of a picture in 200 colours."""
    image = Image.open(source).convert("RGB")
    image = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
    image.quantize(200, dither=Image.Dither.NONE).save(target, optimize=True)


def main(results: Path, names: list[str]) -> None:
    """Run what is not finished, then draw."""
    for name, entry in shipped().items():
        if entry.file.parent.name.startswith("effects") or (names and name not in names):
            continue
        folder = results / name
        record = folder / "run.json"
        if not record.is_file() or json.loads(record.read_text())["outcome"] != "finished":
            command, *more = COMMANDS[entry.kind]
            arguments = [sys.executable, "-m", "granfabric", command, name, "-o", str(folder), *more]
            subprocess.run(arguments, check=True)
        subprocess.run([sys.executable, "-m", "granfabric", "plot", str(folder)], check=True)
        shrink(folder / SHOWN[entry.kind], FIGURES / f"scene_{name}.png")
        if (folder / "closed_form.png").is_file():
            shrink(folder / "closed_form.png", FIGURES / f"scene_{name}_closed_form.png", WIDTH // 2)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("results/scenes"), sys.argv[2:])
