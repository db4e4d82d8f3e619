from humanoid_mjx.cli import main

main()
