#!/usr/bin/env python3
"""Dead code that compilers do not see: names that are public, or in OpenCL C, and that stand nowhere but in their definition.

rustc takes every `pub` item of a library for used, and OpenCL compilers say nothing of functions and macros in headers. What is
generated may have more than is used today.
"""

import re
import sys
from collections import Counter

from tree import read, text_files

COMMENT_LINE = re.compile(r"^[ \t]*//.*", re.MULTILINE)
RUST = re.compile(r"\bpub(?:\([a-z ]+\))? (?:const |unsafe |async )*(?:fn|struct|enum|trait|type|const|static) (\w+)")
OPENCL = re.compile(r"^\s*#\s*define (\w+)|^\w[\w *]*[ *](\w+)\([^()]*\)\s*\{", re.MULTILINE)


def main():
    files = [path for path in text_files("kernels", "server", "tests") if path.suffix in (".rs", ".cl", ".h")]
    texts = {path: COMMENT_LINE.sub("", read(path)) for path in files}
    uses = Counter(word for text in texts.values() for word in re.findall(r"\w+", text))
    found = []
    for path, text in texts.items():
        if "Generated: " in read(path)[:200]:
            continue
        for match in (RUST if path.suffix == ".rs" else OPENCL).finditer(text):
            name = match[1] or match[match.lastindex]
            if uses[name] == 1:
                found.append(f"{path}: {name} is used nowhere")
    print("\n".join(found), end="\n" if found else "")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
