"""Names that would become code or markup where a program writes them without care."""

import numpy as np

# `CANARY` stands for what must not run: window.hacked in a browser, a symbol in C.
PIECES = (
    "<iframe srcdoc='<script>parent.window.hacked=1</script>'></iframe>",
    "<script>window.hacked=1</script>", "<img src=x onerror=window.hacked=1>",
    "{window.hacked=1}", "{`${window.hacked=1}`}", "<b>", "</b>", "<!--", "-->", "&lt;", "&amp;",
    "&#60;", "]]>", "<![CDATA[", "javascript:window.hacked=1", "[a](javascript:window.hacked=1)",
    "![x](/etc/passwd)", "export const hacked = 1", "import x from 'y'", "```", "`", "``", "|",
    "\\|", "**", "_", "~~", "# ", "- ", "1. ", "> ", "$x$", "$$", "*/ int hacked = 1; /*", "*/",
    "/*", "//", "??/", "\\", '"', "'", '" + hacked() + "', "\\\" hacked \\\"", "\n", "\r\n", "\t",
    "\0", "\x1b[31m", "\u2028", "\u202e", "\ufeff", "%s", "%n", "{0}", "${hacked}", "$(hacked)",
    "; hacked", "#x", "=", "[section]", "../", "..", "/", "a", "é", "関節", "😀", " ", "  ", "-p",
    "${1+1}", "<%= 1 %>", "{{1}}", "&", "'", "\"><svg onload=window.hacked=1>",
    "' onload='window.hacked=1", "--!>", "\\u003cb\\u003e",
)  # fmt: skip


def hostile_names(count: int, seed: int = 40) -> list[str]:
    """Return names, each of one to three pieces; every piece stands in one alone."""
    rng = np.random.default_rng(seed)
    names = list(PIECES)
    while len(names) < count:
        chosen = rng.choice(len(PIECES), int(rng.integers(2, 4)))
        names.append("".join(PIECES[k] for k in chosen))
    return names[:count]
