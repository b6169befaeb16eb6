"""The science of Multicap: from synchronised videos to animated skeletons. Imports nothing of the service."""
