"""Names that are bare words (adjectives, participles, pronouns, numerals, adverbs), listed by room.

    python tools/bare_names.py                   # a table: room, names bound, bare words, their share
    python tools/bare_names.py candata/datasets  # each bare word of one folder, with its file and line

A name is counted each time it is bound: as a variable, a parameter, a field, a function or a class. Words that are a
term of the field (`low` and `high` of a range, `mean`, `raw`) and the loop's short letters are not listed. Fields of
records are not counted: files hold them under these names. Exit 1 when
a room outside `candata/gap` has more than `LIMIT` of such names.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Largest share of bare words among the names of a room; `candata/gap` is listed and not limited.
LIMIT = 0.02
UNLIMITED = ("candata/gap",)

PRONOUNS = """all another any anything both each either enough everything few fewer it its itself least less little many
mine more most much neither none nothing one ones other others own ours same several some something such that theirs
them these they thing things this those what which whole whose why"""
NUMERALS = "two three four five six seven eight nine ten second third fourth half once twice zeroth"
ADVERBS = """about above after again against ahead alike alone along already also apart around aside away back before
beforehand behind below beneath beside besides between beyond by down elsewhere ever everywhere far forth forward here
hence how in inside instead into later like maybe near nearly never next now off often on only onto out outside over
past perhaps since so soon still than then there thereby through thus to together too toward under until up upon very
well when whence where wherever while within without yet"""
ADJECTIVES = """able alive apt bad best better big blunt brief bright broad clean clear clever close coarse cold common
dead dear deep dense different dry dull early easy empty equal even extra faint fair fast fat few fine first firm fit
flat foreign free fresh full good great hard harder heavy hot idle large larger largest last late later latest like
likely live long longer longest loose main middle missing narrow nearer nearest neat new newer newest nice odd old older
open ordinary plain poor possible present pure quick quiet ready recent rich right ripe rough safe scarce shallow sharp
sharper short shorter shortest shy silent simple single slight slow small smaller smallest smooth sole sound spare
special stale steady stiff strange strong stronger strongest sure tall thick thin tight tiny true typical uneven
unknown usual weak weaker weakest wide wider widest worse worst wrong young"""
PARTICIPLES = """asked bound begun bent born borne broken brought built bought caught chosen cut done drawn driven eaten
fallen fed felt forgotten fought found frozen given gone got grown had heard held hidden hurt kept known laid lain led
left lent let lit lost made meant met mixed paid put quit read ridden risen run said seen sent set shaken shown shut
sold spent spoken spun stood struck stuck sunk sworn swept taken taught thought thrown told torn undone understood
unread woken won worn written"""
#: Nouns and terms of the field that end like participles.
NOUNS = """backing bearing binding bed bleed breed building casing ceiling coating coupling creed damping deed encoding
ending exceeding feed feeling fitting greed heading heed king loading logging mapping meaning need padding ping pricing
reading readings recording recordings reed ring rolling schooling seed seeds setting settings shed sibling sliding speed
speeds sting steed string strings spring springs thing timing training tubing tuning weed wing wedding weighting embed
embedding finding findings string building friction bring embeddings encodings headings mappings rings spacing indexed
signed typed unsigned drawing scaling sampling spelling masked polling forecasting ordering labeling writing"""

#: Words above that are the field's terms (a fit, a run, the first of two bodies' free joints), or Python's own (`out`).
TERMS = frozenset({"expected", "fit", "free", "masked", "out", "predicted", "real", "run", "sealed", "true"})
#: Parents of what is stored in files or printed as JSON.
RECORDS = {"Record", "ResultRecord"}
#: Words above that are verbs as well: a function may be called so.
VERBS = frozenset(
    {"close", "clean", "clear", "cut", "empty", "forward", "let", "lead", "open", "put", "read", "set", "shut"}
)
BARE = frozenset(" ".join((PRONOUNS, NUMERALS, ADVERBS, ADJECTIVES, PARTICIPLES)).split())
ALLOWED = frozenset(NOUNS.split())


def is_bare(name: str, is_function: bool = False) -> bool:
    """Tell whether a name is one bare word."""
    stripped = name.strip("_")
    word = stripped.lower()
    if word != stripped and stripped not in (word.upper(), word.capitalize()):
        return False
    if (
        name.startswith("__")
        or not word.isalpha()
        or len(word) < 2
        or word in ALLOWED | TERMS
        or (is_function and word in VERBS)
    ):
        return False
    return word in BARE or (len(word) > 4 and word.endswith(("ed", "ing")))


def bindings(tree: ast.AST) -> Iterator[tuple[str, int, bool]]:
    """Yield each name that a module binds, its line, and whether it is a function's; fields of records left out."""
    stored_fields = {
        id(field.target)
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and {ast.unparse(base) for base in node.bases} & RECORDS
        for field in node.body
        if isinstance(field, ast.AnnAssign)
    }
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name, node.lineno, True
            case ast.Name(id=name, ctx=ast.Store()) if id(node) not in stored_fields:
                yield name, node.lineno, False
            case ast.ClassDef(name=name) | ast.arg(arg=name):
                yield name, node.lineno, False


def room(path: Path) -> str:
    """Return the room of a file: `candata/NAME`, or the package that it lies in."""
    parts = path.relative_to(ROOT).parts
    return "/".join(parts[:2]) if len(parts) > 2 else parts[0]


def main() -> int:
    """Print the table, or the words of the folders given, and return 1 where a room has too many."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, help="folders or files whose bare words are listed")
    given = parser.parse_args()
    bound: Counter[str] = Counter()
    bare: Counter[str] = Counter()
    for path in sorted(p for package in ("candata", "candata_cli") for p in (ROOT / package).rglob("*.py")):
        listed = any(path.is_relative_to(folder.resolve()) for folder in given.paths)
        for name, line, is_function in bindings(ast.parse(path.read_text())):
            bound[room(path)] += 1
            if is_bare(name, is_function):
                bare[room(path)] += 1
                if listed:
                    print(f"{path.relative_to(ROOT)}:{line}: {name}")
    if given.paths:
        return 0
    print(f"{'room':<24}{'names':>8}{'bare':>8}{'share':>9}")
    for name in sorted(bound):
        print(f"{name:<24}{bound[name]:>8}{bare[name]:>8}{100 * bare[name] / bound[name]:>8.1f}%")
    limited = [name for name in bound if name not in UNLIMITED]
    share = sum(bare[name] for name in limited) / sum(bound[name] for name in limited)
    print(
        f"{'all but ' + ', '.join(UNLIMITED):<32}{'':>8}{100 * share:>8.1f}%   target: at most {100 * LIMIT:g} % a room"
    )
    return int(any(bare[name] > LIMIT * bound[name] for name in limited))


if __name__ == "__main__":
    sys.exit(main())
