"""What Feature4X does, one function for each: the command line, agents, jobs of Blender and `import f4x_core` call the same."""
