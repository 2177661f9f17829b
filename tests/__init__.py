"""Tests; a package, as libraries install packages of this name, which would be found first."""
