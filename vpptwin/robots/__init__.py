"""Robots that ship with the package, each in a folder of its own.

Most robots need no code: a twin file names an MJCF and signals, and `Robot` reads them. One that does something
otherwise has a class of `Robot` whose `hooks` name its own functions: a general function that is marked `by_robot`
(reading signals, drawing, plotting, exporting) calls the function that the hook of its name leads to. So general rooms
import nothing from here but what reads the robot's twin file, and a robot may import any room. tests/test_layers.py
checks both; `grep -A1 @by_robot` lists what has a hook.
"""
