"""The science of HESR: logs, rigid bodies, friction laws and how they are fitted."""
