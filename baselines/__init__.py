"""The methods MIHO is compared with, each a class behind the interface of `miho.optim`."""
