"""Sphinx's settings: `make docs` writes the site to target/docs.

The source folder is the whole repository, so that links between guides, README, results and the rest are
the same in the repository and on the site.
"""

import contextlib
import io
import re

from docutils import nodes
from docutils.parsers.rst import Directive

import nanite_rs
from nanite_rs import cli

project = "nanite_rs"
version = release = nanite_rs.__version__
project_copyright = ""
html_show_copyright = False

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "docs/reference/*.rst",
    "benchmarks/README.md",
    "benchmarks/results/*.md",
    "fuzz/README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "README.md",
]
exclude_patterns = [".venv", "target", "**/.*"]
templates_path = ["_templates"]

# Markdown: headings are targets as they are where repositories are shown, and [ ] is text.
myst_heading_anchors = 4

# `NaniteMesh.cut` in a docstring is a link where there is such a name, and code where not.
default_role = "py:obj"
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "mixed"
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
python_maximum_signature_line_length = 80
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"nanite_rs {release}"
html_copy_source = False
# The front page lies in docs/, as its source does; index.html leads there.
html_additional_pages = {"index": "redirect.html"}


def prepare(_app, what, _name, _object, _options, lines):
    """What docstrings call docs/numerics.md is a link on the site, and those of attributes are prose.

    Napoleon takes the first line of an attribute's docstring up to a colon for its type: here that line is an
    escaped end of line, which shows as nothing.
    """
    lines[:] = [re.sub(r"(?<!`)\bdocs/(\w+)\.md\b", r":doc:`/docs/\1`", line) for line in lines]
    if what in ("attribute", "data", "property"):
        lines.insert(0, "\\")


def hide_internal(_app, what, _name, _object, _options, signature, _returns):
    """Classes that only the package makes are shown without how."""
    made_inside = what == "class" and re.search(r"\b(core|handle)\b", signature or "")
    return ("", None) if made_inside else None


class CommandHelp(Directive):
    """What the command line prints for ``--help``, of the command that is named."""

    optional_arguments = 1

    def run(self):
        """A literal block."""
        with contextlib.redirect_stdout(io.StringIO()) as text:
            cli.main([*self.arguments, "--help"])
        return [nodes.literal_block(text.getvalue(), text.getvalue(), language="text")]


def setup(app):
    """What Sphinx calls."""
    app.add_directive("command-help", CommandHelp)
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("autodoc-process-signature", hide_internal)
