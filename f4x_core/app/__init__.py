"""The operations of Feature4X, a function each: the command line, agents, jobs of Blender and `import f4x_core` call them."""
