"""The command that shows or clears the cache of compiled libraries."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from .arguments import Json
from .reports import as_json, terminal

if TYPE_CHECKING:
    from piaffe.codegen import Cache

_UNITS = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"), (0.0, "s"))


def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Remove all compiled libraries.")] = False,
    json: Json = False,
) -> None:
    """List the compiled libraries in the cache, with purpose, size and age; or remove them."""
    from piaffe.codegen import Cache

    kept = Cache()
    if clear:
        removed, freed = kept.clear()
        text = f"libraries removed: {removed}, freed: {megabytes(freed)}"
        print(as_json({"removed": removed, "freed": freed}) if json else text)
    elif json:
        print(as_json(cache_values(kept)))
    else:
        print_cache(terminal(), cache_values(kept))


def cache_values(cache: Cache) -> dict[str, Any]:
    """Return the values that ``cache --json`` prints."""
    from piaffe.codegen import fault_of, this_cpu

    now, cpu = time.time(), this_cpu()
    entries = [
        {
            "key": entry.folder.name, "label": entry.manifest.get("label", ""), "size": entry.size,
            "age_s": now - entry.manifest.get("built_at", entry.used), "unused_s": now - entry.used,
            "compile_s": entry.manifest.get("seconds"), "width": entry.manifest.get("width"),
            "compiler": entry.manifest.get("compiler", ""), "fault": fault_of(entry, cpu),
        }
        for entry in cache.entries()
    ]  # fmt: skip
    return {"folder": str(cache.folder), "size": cache.size(), "limit": cache.limit, "entries": entries}


def print_cache(console: Console, values: dict[str, Any]) -> None:
    """Print the folder of the cache, its size, and a line per library."""
    entries = values["entries"]
    libraries = "library" if len(entries) == 1 else "libraries"
    console.print(f"{values['folder']}", markup=False, soft_wrap=True)
    console.print(f"{len(entries)} {libraries}, {megabytes(values['size'])} of at most {megabytes(values['limit'])}")
    if not entries:
        return
    table = Table(box=None, pad_edge=False)
    for name in ("library", "for"):
        table.add_column(name)
    for name in ("size", "built", "used", "compiled in", "SIMD lanes"):
        table.add_column(name, justify="right")
    table.add_column("")
    for entry in entries:
        spent = entry["compile_s"]
        cells = (
            entry["key"][:12], entry["label"], megabytes(entry["size"]), _ago(entry["age_s"]), _ago(entry["unused_s"]),
            "?" if spent is None else f"{spent:.1f} s", str(entry["width"] or "?"),
            f"not used here: {entry['fault']}" if entry["fault"] else "",
        )  # fmt: skip
        table.add_row(*(cell.replace("[", r"\[") for cell in cells))
    console.print(table)


def megabytes(size: float) -> str:
    """Return a size in bytes as text, in MiB or GiB."""
    return f"{size / 2**20:.1f} MiB" if size < 2**30 else f"{size / 2**30:.1f} GiB"


def _ago(seconds: float) -> str:
    length, unit = next((pair for pair in _UNITS if seconds >= 2 * pair[0]), _UNITS[-1])
    return f"{max(0.0, seconds) / (length or 1.0):.0f} {unit} ago"
