"""`python -m experiments.faults`; the processes of the rows import this file, and nothing more."""

if __name__ == "__main__":
    from experiments.faults.command import main

    main()
