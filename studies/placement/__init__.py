"""The study of chapter 2: do placed objects stay, and which release strategy and which world decide it?"""
