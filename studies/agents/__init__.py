"""Do published agents hold, and do they after the cure?"""
