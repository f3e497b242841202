"""Random small scenes played by plain MuJoCo: a witness that shares no stepping code with what it checks.

Nothing here steps, records or changes a world through `candata.simulate`, the effects' hooks or a `Scene`.
"""
