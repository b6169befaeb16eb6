"""Characters out of FBX files of strangers: skeleton, rest pose, skinned meshes and colours, as a glTF document."""
