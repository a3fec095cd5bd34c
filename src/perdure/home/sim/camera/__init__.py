"""Offscreen rendering, and the head camera's depth image.

Contents:
    depth    HeadCamera: what the head camera measures
"""
