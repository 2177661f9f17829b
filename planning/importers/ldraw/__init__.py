"""LDraw, the format of LEGO programs such as LeoCAD and Studio: parts, reader, writer.

Imports planning's own files and the models of bricks; nothing in planning imports it.
"""
