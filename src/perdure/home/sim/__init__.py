"""The simulated world: a Fetch in an apartment full of objects.

Contents:
    robot         the Fetch as MJCF, its kinematics and inverse kinematics
    objects       the ten YCB objects
    apartments    rooms, furniture and the free space in them
    world         scenes, worlds side by side, the magic grasp, state
    camera        offscreen rendering and the head camera's depth image
"""
