#!/usr/bin/env python3
"""Cells of tables in pages: none has more than 15 words, as longer text is a list or a paragraph.

Prints `file:line: words` for each cell that has more. Targets of links are no words.
"""

import re
import sys

from tree import read, text_files

MAX_WORDS = 15

# (file, why its cells may have more)
EXCEPTIONS = {
    "BENCHMARKS.md": "written by `make bench`",
    "CHANGELOG.md": "says what was released in the words of that time",
}

# `\|` does not end a cell.
BAR = re.compile(r"(?<!\\)\|")
TARGET = re.compile(r"\]\([^)]*\)")


def long_cells(text):
    """Line, number of words and text of each cell that has too many."""
    in_code = False
    for number, line in enumerate(text.split("\n"), 1):
        line = line.strip()
        if line.startswith(("```", "~~~")):
            in_code = not in_code
        if in_code or not line.startswith("|"):
            continue
        for cell in BAR.split(line):
            words = len(TARGET.sub("]", cell).split())
            if words > MAX_WORDS:
                yield number, words, cell.strip()


def main():
    count = 0
    for path in text_files("."):
        if path.suffix != ".md" or str(path) in EXCEPTIONS:
            continue
        for number, words, cell in long_cells(read(path)):
            print(f"{path}:{number}: a cell has {words} words, expected at most {MAX_WORDS}: {cell[:60]}")
            count += 1
    sys.exit(count > 0)


if __name__ == "__main__":
    main()
