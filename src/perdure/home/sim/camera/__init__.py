"""Offscreen rendering, and the head camera's depth image.

Contents:
    depth    HeadCamera: what the head camera measures
    gl       a rendering context without a window
"""
