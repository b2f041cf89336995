"""The version of the package, here and nowhere else but in package.xml, where ROS wants it."""

VERSION = "0.1.0"
