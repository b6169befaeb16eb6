"""Result files of a reconstruction, in the formats of animation and motion analysis software."""
