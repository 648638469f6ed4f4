"""Write the gallery: a page with the sentence, a picture, the commands and the code of every example.

Run it after an example is added or changes: ``python docs/gallery/make.py --text`` writes the page alone,
``python docs/gallery/make.py NAME ...`` also the pictures of these examples, and without a name those of all examples,
which takes some minutes. Solutions and episodes are kept in ``build/gallery``; remove a file there to compute it again.
"""

import json
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
EXAMPLES = ROOT / "examples"
PICTURES = HERE.parent / "assets" / "gallery"
PAGE = HERE / "index.md"

GROUPS = {
    "Motions": (
        "barrel_roll.py", "backflip.py", "sideways_hop.py", "box_jump.py", "stairs_trot.py", "gaits.py", "cascade.py",
        "run_roll_run.py", "randomised_mass.py",
    ),
    "Robots, models and terms of your own": (
        "own_robot.ipynb", "biped.py", "reach.py", "own_terms.py", "own_dynamics.py",
    ),
    "Receding horizons": (
        "trot_mpc.py", "bound_mpc.py", "gaits_mpc.py", "go2_mpc.py", "stairs_mpc.py", "roll_then_pace.py",
        "trot_pace_roll.py", "running_roll.py", "run_roll_run_mpc.py", "front_flip_run.py", "own_model_mpc.py",
    ),
    "Sampling": (
        "trot_mppi.py", "stairs_mppi.py", "short_horizon.py", "train_value.py", "own_sampler.py",
    ),
}  # fmt: skip
"""Heading → examples in order. Other examples follow under a heading of their own."""
OTHERS = "More"
ALONE = ("notebook_tour.ipynb",)
"""The examples at the head of the page."""


def examples() -> list[str]:
    """Return the file names of all examples."""
    return sorted(path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb"))


def groups() -> dict[str, list[str]]:
    """Return the examples by heading, each once."""
    known, there = [*ALONE, *(name for names in GROUPS.values() for name in names)], examples()
    found = {"": [*ALONE], **{heading: list(names) for heading, names in GROUPS.items()}}
    found[OTHERS] = [name for name in there if name not in known]
    return {heading: [name for name in names if name in there] for heading, names in found.items()}


def cells(name: str, kind: str) -> list[str]:
    """Return the sources of a notebook's cells of a kind."""
    read = json.loads((EXAMPLES / name).read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in read if cell["cell_type"] == kind]


def sentence(name: str) -> str:
    """Return what an example is: the first line of its docstring, or the text below the title of a notebook."""
    if name.endswith(".ipynb"):
        text = cells(name, "markdown")[0].split("\n\n", 1)[1]
        return " ".join(text.split())
    first = (EXAMPLES / name).read_text(encoding="utf-8").split("\n", 1)[0]
    return first.strip('"').replace("``", "`")


def commands(name: str) -> str:
    """Return the commands that run an example: those of its section in ``examples/README.md``."""
    parts = re.split(r"^## (\S+)$", (EXAMPLES / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    own = re.split(r"^## ", sections.get(name, ""), maxsplit=1, flags=re.MULTILINE)[0]
    found = re.findall(r"^```bash\n(.*?)^```$", own, flags=re.MULTILINE | re.DOTALL)
    start = "jupyter lab" if name.endswith(".ipynb") else "python"
    return "".join(found) or f"{start} examples/{name}\n"


def code(name: str) -> list[str]:
    """Return the lines that show the code of an example."""
    if not name.endswith(".ipynb"):
        return [f'--8<-- "examples/{name}"']
    return "\n\n# ----\n\n".join(cells(name, "code")).splitlines()


def entry(name: str) -> list[str]:
    """Return the lines of an example on the page."""
    shown = [f"    {line}".rstrip() for line in ("```python", *code(name), "```")]
    return [
        f"### {name}", "", sentence(name), "", f"![{name}](../assets/gallery/{picture(name)})", "",
        "```bash", *commands(name).splitlines(), "```", "", f'??? example "examples/{name}"', "", *shown, "",
    ]  # fmt: skip


def picture(name: str) -> str:
    """Return the file name of an example's picture."""
    return f"{name.partition('.')[0]}.jpg"


def page() -> str:
    """Return the text of the page."""
    lines = [
        "# Gallery", "",
        "Each file in the folder `examples/` shows one idea, and runs by itself.",
        "Below each picture are the commands that run the example. A click on its name shows the code.",
        "Arrows are the contact forces of a solution.",
        "Poses of receding horizons and of sampling are those of a simulated robot.",
        "",
    ]  # fmt: skip
    for heading, names in groups().items():
        lines += [f"## {heading}", ""] if heading and names else []
        for name in names:
            lines += entry(name)
    return "\n".join(lines)


def main(names: list[str], text_only: bool = False) -> None:
    """Write the page, and the pictures of some examples, or of all."""
    PAGE.write_text(page(), encoding="utf-8")
    if text_only:
        return
    from pictures import draw  # in this folder

    PICTURES.mkdir(exist_ok=True)
    for name in [each.partition(".")[0] for each in names or examples()]:
        draw(name, PICTURES / f"{name}.jpg")


if __name__ == "__main__":
    given = [word for word in sys.argv[1:] if not word.startswith("-")]
    main(given, text_only="--text" in sys.argv)
