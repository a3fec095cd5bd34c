"""Learned policies, release strategies and scripted skills."""
