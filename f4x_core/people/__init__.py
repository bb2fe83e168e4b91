"""People in pictures: trained networks of an ordinary package find them, their joints and their masks. Torch-free.

`networks` runs the two networks on one picture, `finding` finds everyone in one picture, `following` follows each through the
clip. People are found, never recognised: nothing here knows an identity, an age or a gender.
"""
