"""Does further training with a longer horizon, under noise, make a policy hold?"""
