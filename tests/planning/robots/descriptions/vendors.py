"""Descriptions of arms and grippers that vendors publish, and small ones of our own."""

from pathlib import Path

import pytest

GRIPPER = """<robot name="gripper">
  <link name="palm"><collision><origin xyz="0 0 0.05"/>
    <geometry><cylinder radius="0.04" length="0.1"/></geometry></collision></link>
  <link name="left"><collision><geometry><box size="0.02 0.01 0.06"/></geometry></collision></link>
  <link name="right"><collision><geometry><box size="0.02 0.01 0.06"/></geometry></collision></link>
  <link name="tcp"/>
  <joint name="squeeze" type="prismatic"><parent link="palm"/><child link="left"/>
    <origin xyz="0 0.005 0.12"/><axis xyz="0 1 0"/><limit lower="0" upper="0.04"/></joint>
  <joint name="follow" type="prismatic"><parent link="palm"/><child link="right"/>
    <origin xyz="0 -0.005 0.12"/><axis xyz="0 1 0"/><limit lower="-0.04" upper="0"/>
    <mimic joint="squeeze" multiplier="-1"/></joint>
  <joint name="point" type="fixed"><parent link="palm"/><child link="tcp"/><origin xyz="0 0 0.14"/></joint>
  <vendor:note about="nothing"/>
</robot>"""
"""A gripper of two fingers that mimic each other, with a prefix that stands for nothing."""


def vendor_file(place: str) -> Path:
    """Return a file of the package airo-models; skips the test where it is not installed."""
    package = pytest.importorskip("airo_models")
    return Path(package.__file__).parent / place


def ur5e() -> Path:
    """Return the description of a UR5e: ROS-Industrial's frames, attributes of Drake."""
    return vendor_file("arms/ur5e/ur5e.urdf")


def robotiq() -> Path:
    """Return the description of a Robotiq 2F-85: five joints mimic a sixth."""
    return vendor_file("grippers/robotiq_2f_85/urdf/robotiq_2f_85.urdf")
