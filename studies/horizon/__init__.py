"""Does a policy trained in finite episodes hold for 100,000 steps, and does a constant time-to-go help?"""
