"""Robot descriptions as XML, read as leniently as the programs that vendors write them for."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from planning.errors import RobotModelError
from planning.files import is_file, read_file

# Some files begin with comments, and say only then that they are XML.
_DECLARATION = re.compile(rb"\A((?:\s+|<!--.*?-->)+)<\?xml[^>]*\?>", re.DOTALL)


def read_xml(path: Path) -> Element:
    """Return the root of an XML file, prefixes of names left as they are written.

    Files of vendors name elements such as ``drake:member`` and attributes such as
    ``drake:acceleration`` without saying what the prefix stands for.

    Raises:
        RobotModelError: the file is missing, cannot be read, or is not XML.
    """
    if not is_file(path):
        raise RobotModelError(f"robot description {path} does not exist")
    try:
        content = read_file(path)
    except OSError as error:
        raise RobotModelError(f"{path} cannot be read: {error.strerror}") from None
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        # Some files end with a byte that is nought.
        content = content.rstrip(b"\0 \t\r\n")
        parser.Parse(_DECLARATION.sub(rb"\1", content, count=1), True)
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError, AssertionError) as error:
        raise RobotModelError(f"{path} is not XML: {error}") from None


def without_prefixes(root: Element) -> None:
    """Take elements and attributes with a prefix out: they are notes to other programs."""
    for element in list(root.iter()):
        for child in list(element):
            if ":" in child.tag:
                element.remove(child)
        for key in [key for key in element.attrib if ":" in key]:
            del element.attrib[key]
