"""The methods MIHO is compared with: those that wrap a library, and those of `miho.methods`."""
