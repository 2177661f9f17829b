"""Kinds of assembly in the twin, a folder each; the registry names them, and nothing else imports them."""
