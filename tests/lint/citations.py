#!/usr/bin/env python3
"""Citations of pages: what a comment or a document cites exists.

- A link in a page leads to a file, and to a heading of it where it names one (GitHub's slugs).
- A page named in a comment exists, with the heading that follows it: `#slug`, or `, section N` of numbered ones. A path counts
  from the file's own folder or any above it; a name alone may also be the only page of that name.
- `make TARGET` in a page, as code, is a target of the Makefile.
- A test that a page names, five words or more, is a function.
- No comment cites a section of "the algorithm" by number alone: docs/algorithm.md has headings.
"""

import re
import sys
from functools import cache
from pathlib import Path

from tree import ROOT, read, text_files

LINK = re.compile(r"\]\(<?([^()\s>]+)>?\)|^\[[^\]]+\]:\s+(\S+)", re.MULTILINE)
PAGE = re.compile(r"(?<![\w/*.{}-])((?:[\w.-]+/|\.\./)*[\w-]+\.md)(?:#([\w-]+)|`?,? sections? (\d+))?")
UNNAMED_PAGE = re.compile(r"\balgorithm,?\s+sections?\b", re.IGNORECASE)
MAKE = re.compile(r"(?:`|^    )make ([a-z][a-z0-9-]*)", re.MULTILINE)
TEST = re.compile(r"`(?!isopeel_)([a-z0-9]+(?:_[a-z0-9]+){4,})`")
FILES = text_files(".")


def without_code_blocks(text):
    """The page with its code blocks emptied, line numbers kept."""
    return re.sub(r"^( *)(```|~~~).*?^ *\2", lambda block: "\n" * block[0].count("\n"), text, flags=re.M | re.S)


@cache
def headings(page):
    """The anchors of a page, and the numbers of its numbered headings."""
    text, slugs, numbers = without_code_blocks(read(page)), {}, set()
    for title in re.findall(r"^#{1,6} +(.+?) *#*$", text, re.MULTILINE):
        title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        slug = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        slugs[slug] = slugs.get(slug, -1) + 1
        if number := re.match(r"(\d+)\b", title):
            numbers.add(number[1])
    anchors = {f"{slug}-{n}" if n else slug for slug, last in slugs.items() for n in range(last + 1)}
    return anchors | set(re.findall(r'<a (?:id|name)="([^"]+)"', text)), numbers


@cache
def targets():
    """What can be made."""
    return set(re.findall(r"^([a-z][a-z0-9-]*)[^=\n]*:(?!=)", read(Path("Makefile")), re.MULTILINE))


@cache
def functions():
    """Names of all functions."""
    return {name for path in FILES if path.suffix == ".rs" for name in re.findall(r"\bfn (\w+)", read(path))}


def find_page(citing, name):
    for folder in citing.parents:
        if (ROOT / folder / name).is_file():
            return (ROOT / folder / name).resolve().relative_to(ROOT)
    same_name = [path for path in FILES if path.name == name]
    return same_name[0] if len(same_name) == 1 else None


def problems(path):
    """Pairs of a position in the file and what is wrong there."""
    text = read(path)
    for match in UNNAMED_PAGE.finditer(text):
        yield match.start(), f"cites '{match[0]}' of an unnamed page: link to a heading of docs/algorithm.md"
    if path.suffix == ".md":
        for match in MAKE.finditer(text):
            if match[1] not in targets():
                yield match.start(), f"names make {match[1]}, no target of the Makefile"
        for match in TEST.finditer(text):
            if match[1] not in functions():
                yield match.start(), f"names the test {match[1]}, which does not exist"
        text = without_code_blocks(text)
        for match in LINK.finditer(text):
            target, _, anchor = (match[1] or match[2]).partition("#")
            if re.match(r"[a-z]+:", target):
                continue
            linked = (ROOT / path.parent / target).resolve() if target else ROOT / path
            if not linked.exists() or not linked.is_relative_to(ROOT):
                yield match.start(), f"links to {target}, which does not exist"
            elif anchor and anchor not in headings(linked.relative_to(ROOT))[0]:
                yield match.start(), f"links to {target}#{anchor}, no heading of that page"
        text = LINK.sub(lambda link: " " * len(link[0]), text)
    for match in PAGE.finditer(text):
        name, anchor, number = match.groups()
        page = find_page(path, name)
        if page is None:
            yield match.start(), f"names {name}: no page there, or several"
        elif anchor and anchor not in headings(page)[0]:
            yield match.start(), f"cites {name}#{anchor}, no heading of {page}"
        elif number and number not in headings(page)[1]:
            yield match.start(), f"cites {name}, section {number}: no heading of {page} has that number"


def main():
    count = 0
    for path in FILES:
        text = read(path)
        for position, problem in problems(path):
            print(f"{path}:{text.count(chr(10), 0, position) + 1}: {problem}")
            count += 1
    sys.exit(count > 0)


if __name__ == "__main__":
    main()
