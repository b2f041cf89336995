"""Text from files and users as data: one escape function for each format that it is written into.

A name, a path or a refusal that enters HTML, XML, Markdown or C passes through the function of that
format. No reader of the format therefore takes a part of it for markup or code.
"""

import html
import re

_ASCII_MARKS = re.compile(r"[!-/:-@\[-`{-~]")
_PLAIN_IN_C = re.compile(r"[A-Za-z0-9 _.,:;+/()#<>=@-]")


def escape_to_line(text: str) -> str:
    """Return a text on one line, as a comment of YAML takes it: `?` is what cannot be printed."""
    return "".join(c if c.isprintable() else "?" for c in text)


def escape_html(text: str) -> str:
    """Return a text for the content of an HTML element, or for a quoted attribute."""
    return html.escape(escape_to_line(text))


def escape_xml(text: str) -> str:
    """Return a text that XML can hold, on one line; the writer of the XML escapes its markup.

    XML 1.0 has no way to write control characters and halves of surrogate pairs.
    """
    return escape_to_line(text)


def escape_markdown(text: str) -> str:
    r"""Return a text for a paragraph or a table of Markdown, on one line.

    The page renders HTML in Markdown, frames with JavaScript among it. MDX, as other pages have it,
    runs `{...}`, and lines that begin with `import` or `export`. Both and
    CommonMark take a mark of ASCII behind a backslash as it is
    (https://spec.commonmark.org/0.31.2/#backslash-escapes, https://mdxjs.com/docs/what-is-mdx/).
    """
    line = _ASCII_MARKS.sub(r"\\\g<0>", escape_to_line(" ".join(text.split())))
    if line.startswith(("import", "export")):
        line = f"&#{ord(line[0])};{line[1:]}"
    return line


def escape_c_comment(text: str) -> str:
    """Return a text for a block comment of C or C++, on one line."""
    return escape_to_line(text).replace("\\", "/").replace("*/", "* /").replace("/*", "/ *")


def escape_c_string(text: str) -> str:
    """Return a string literal of C or C++ in plain ASCII, with its quotation marks."""
    plain = (c if _PLAIN_IN_C.fullmatch(c) else _format_octal(c) for c in text)
    return f'"{"".join(plain)}"'


def _format_octal(character: str) -> str:
    encoded = character.encode(errors="surrogateescape")
    return "".join(f"\\{byte:03o}" for byte in encoded)
