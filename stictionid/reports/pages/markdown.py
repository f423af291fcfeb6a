"""Facts and pictures as markdown that the common forges render, with the pictures as files beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence

from .. import facts as facts_of
from ..document import Facts, PageTable, Section
from ..pictures.curves import Case
from ..pictures.picture import Picture

KIND = "<!-- stictionid report -->"
_SPECIAL = re.compile(r"([\\`*_\[\]|#~$!])")


def markdown(cases: Sequence[Case], pictures: Sequence[dict[str, Picture]], names: Sequence[dict[str, str]],
             compared: tuple[Picture, str] | None = None) -> str:
    """The report as text; `names` holds the file name of each picture per case, relative to the markdown."""
    parts = [KIND, ""]
    all_facts = [facts_of.facts(c.study, no_pictures=c.missing) for c in cases]
    if len(cases) > 1:
        parts += ["# Valve stiction: comparison", "", table_text(facts_of.comparison([c.study for c in cases])), ""]
        if compared is not None:
            parts += [picture_text(*compared), ""]
    for facts, drawn, files in zip(all_facts, pictures, names, strict=True):
        parts += _study(facts, drawn, files, "#" if len(cases) == 1 else "##")
    return "\n".join(parts).rstrip("\n") + "\n"


def _study(facts: Facts, drawn: dict[str, Picture], files: dict[str, str], level: str) -> list[str]:
    parts = [f"{level} {escape(facts.title)}", "", f"**{escape(facts.headline)}**", ""]
    for sentence in facts.then:
        parts += [f"**{escape(sentence)}**", ""]
    if facts_of.adds(facts):
        parts += [escape(facts.reason), ""]
    parts += [f"- {escape(n.label)}: **{escape(n.value)}**" + (f", {escape(n.note)}" if n.note else "")
              for n in facts.numbers]
    parts.append("")
    for section in facts.sections:
        parts += _section(section, drawn, files, level + "#") if section.shows(drawn) else []
    return parts


def _section(section: Section, drawn: dict[str, Picture], files: dict[str, str], level: str) -> list[str]:
    parts = [f"{level} {escape(section.title)}", ""]
    for sentence in section.text:
        parts += [escape(sentence), ""]
    for bullet in section.bullets:
        parts.append(f"- {escape(bullet)}")
    parts += [""] if section.bullets else []
    for key in section.pictures:
        parts += [picture_text(drawn[key], files[key]), ""] if key in drawn else []
    for table in section.tables:
        parts += [table_text(table), ""]
    if section.lines:
        parts += _block(section.lines, "text")
    if section.commands:
        parts += _block(section.commands, "sh")
    return parts


def _block(lines: Sequence[str], kind: str) -> list[str]:
    """Lines as they are, in a fence longer than any in them."""
    text = "\n".join(lines)
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return [f"{fence}{kind}", text, fence, ""]


def picture_text(picture: Picture, file: str) -> str:
    """A picture in markdown by the name of its file, its caption below it."""
    target = "".join(c if c.isalnum() or c in "-_./" else "".join(f"%{b:02X}" for b in c.encode("utf-8", "replace"))
                     for c in file)
    return f"![{escape(picture.title)}. {escape(picture.alt)}]({target})\n\n*{escape(picture.caption)}*"


def table_text(table: PageTable) -> str:
    """A table in markdown, its caption above it."""
    head = "| " + " | ".join(escape(c) for c in table.columns) + " |"
    rule = "|" + "|".join("---:" if i in table.numeric else "---" for i in range(len(table.columns))) + "|"
    rows = ["| " + " | ".join(escape(c) for c in row) + " |" for row in table.rows]
    return "\n".join([f"**{escape(table.caption)}**", "", head, rule, *rows])


def escape(text: str) -> str:
    """Text that no markdown or HTML reader takes for markup, links, mentions or list marks."""
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    text = _SPECIAL.sub(r"\\\1", text).replace("@", "&#64;").replace("://", ":&#47;/").replace("www.", "www&#46;")
    return re.sub(r"^(\s*)([+=-]|\d+(?=[.)]\s))", r"\1\\\2", text) if text[:1] in "+=-" else \
        re.sub(r"^(\d+)([.)]\s)", r"\1\\\2", text)
