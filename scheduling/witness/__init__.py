"""Independent geometry for verification: robots read by pinocchio, distances measured by coal.

Of planning it uses the plain data of a cell only: names, files, forms and poses.
"""
