"""Write docs/atlas.md and its pictures: every effect of the catalogue on one standard loop.

    python docs/make_atlas.py

tests/test_effects_command.py fails where an effect is missing in docs/atlas.md, or its words have changed.
"""

from __future__ import annotations

from pathlib import Path

from stictionid.effects import catalogue
from stictionid.reports.pages.atlas import atlas_picture, atlas_words
from stictionid.reports.pictures.figures import figure_bytes

HERE = Path(__file__).parent
HEAD = """# Atlas of the effects

What each effect does to valve, process value and residual of one standard loop, in physical order.
`python docs/make_atlas.py` writes this page; `stictionid effects NAME --picture OUT.svg` draws one.
"""


def entry(name: str) -> str:
    """The text of one effect."""
    words = "\n\n".join(atlas_words(name))
    return f"\n## {name}\n\n{words}\n\n![{name}](atlas/{name}.svg)\n"


def main() -> None:
    (HERE / "atlas").mkdir(exist_ok=True)
    for name in catalogue():
        (HERE / "atlas" / f"{name}.svg").write_bytes(figure_bytes(atlas_picture(name), "svg"))
    (HERE / "atlas.md").write_text(HEAD + "".join(map(entry, catalogue())), encoding="utf-8")


if __name__ == "__main__":
    main()
