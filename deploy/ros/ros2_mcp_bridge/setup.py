"""The bridge as a ROS package; its version is that of package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "ros2_mcp_bridge"
PACKAGES = (NAME, "ros2_mcp_common")
# colcon takes modules from the package's own folder. They are linked there at the first build: git keeps a link as a
# file where links are not to be had.
for each in PACKAGES:
    if not Path(each).is_dir():
        Path(each).symlink_to(Path("../../../src", each))
package = ElementTree.parse("package.xml")

setup(
    name=NAME,
    version=package.findtext("version"),
    description=" ".join(package.findtext("description").split()),
    license=package.findtext("license"),
    packages=find_packages(include=[f"{each}*" for each in PACKAGES]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    entry_points={"console_scripts": [f"bridge = {NAME}.__main__:main"]},
)
