# SPDX-License-Identifier: GPL-3.0-or-later
"""Build description of the ament_python package wiforce_ros."""

import xml.etree.ElementTree
from pathlib import Path

from setuptools import setup

PACKAGE = "wiforce_ros"
MANIFEST = xml.etree.ElementTree.parse(Path(__file__).with_name("package.xml")).getroot()

setup(
    name=PACKAGE,
    version=MANIFEST.findtext("version"),
    description=MANIFEST.findtext("description"),
    license=MANIFEST.findtext("license"),
    packages=[PACKAGE],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    entry_points={"console_scripts": [f"press_publisher = {PACKAGE}.press_publisher:main"]},
)
