"""Do policies that hold when calm hold under disturbances, and does the verdict foresee new ones?"""
