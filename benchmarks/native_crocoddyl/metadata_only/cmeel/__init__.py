"""A build backend under the name of the one that the source distributions ask for; it tells their metadata alone.

``pip download`` asks for the metadata of what it downloads, and the real backend compiles everything to answer.
"""

from __future__ import annotations

import tomllib
from pathlib import Path


def prepare_metadata_for_build_wheel(metadata_directory: str, config_settings: object = None) -> str:
    """Write name and version of the project in the current folder; return the folder that holds them."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    folder = Path(metadata_directory, f"{project['name'].replace('-', '_')}-{project['version']}.dist-info")
    folder.mkdir()
    lines = ("Metadata-Version: 2.1", f"Name: {project['name']}", f"Version: {project['version']}", "")
    folder.joinpath("METADATA").write_text("\n".join(lines), encoding="utf-8")
    return folder.name
