"""The end of a command's help: the files that it writes, its JSON, and its exit codes."""

from __future__ import annotations

_CODES = {
    0: "done, whatever the answer", 1: "a rate is worse than chance allows",
    2: "usage, or a file absent or not writable", 3: "content that can't be used", 130: "interrupted",
}
# Undecided with S and J is another outcome: it ends with 0, and with 4 under --strict.
ABSTAINED = "content that can't be used, or a record that holds too little for S and J (abstained)"


def outcome(writes: str, *, json: str = "", abstains: bool = False, strict: str = "", fails: bool = False) -> str:
    """The epilog of a help text; `json` names the result of --json, `strict` says when the exit code is 4."""
    codes = [0, *([1] if fails else []), 2, 3, *([4] if strict else []), 130]
    words = {**_CODES, **({3: ABSTAINED} if abstains else {}), **({4: f"with --strict, {strict}"} if strict else {})}
    parts = [f"Writes: {writes}.", *([f"JSON: {json}."] if json else []),
             "Exit codes: " + "; ".join(f"{code} {words[code]}" for code in codes) + "."]
    return "\n\n".join(parts)
