"""The same exported policy, in the same scenes, in C MuJoCo and in our environment: do they agree?"""
